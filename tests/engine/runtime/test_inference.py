# SPDX-License-Identifier: GPL-3.0-or-later
"""What numba has found out about an operator is not asked again, and is the same as asked anew."""

import operator
from typing import Any

import pytest
from numba.core import types
from numba.core.compiler import Flags
from numba.core.registry import cpu_target
from numba.core.targetconfig import ConfigStack

from engine.runtime.inference import RememberingContext

_OPERATORS = (operator.add, operator.truediv, operator.lt, operator.and_, operator.pow, operator.neg, abs, max)
_SCALARS = (types.float32, types.int64, types.boolean, types.uint32, types.literal(2))


class _Counting:
    """Numba's context, which counts how often it is asked."""

    def __init__(self) -> None:
        self.context = cpu_target.typing_context
        self.asked = 0

    def resolve_function_type(self, *question: Any) -> Any:
        self.asked += 1
        return self.context.resolve_function_type(*question)


def _answer(context: Any, question: Any) -> Any:
    try:
        return context.resolve_function_type(*question)
    except Exception as error:
        return type(error)


@pytest.mark.parametrize("function", _OPERATORS)
def test_answers_are_numbas(function: Any) -> None:
    cpu_target.typing_context.refresh()
    remembering = RememberingContext(cpu_target.typing_context)
    count = 1 if function in (operator.neg, abs) else 2
    questions = [(function, (a, b)[:count], {}) for a in _SCALARS for b in _SCALARS]
    for _ in range(2):
        for question in questions:
            assert _answer(remembering, question) == _answer(cpu_target.typing_context, question)


def test_nothing_is_asked_twice_but_for_what_is_no_number() -> None:
    counting = _Counting()
    counting.context.refresh()
    remembering = RememberingContext(counting.context, counting.resolve_function_type)
    numbers, vector = (types.float32, types.float32), types.UniTuple(types.float32, 3)
    for _ in range(3):
        remembering.resolve_function_type(operator.mul, numbers, {})
    assert counting.asked == 1
    for _ in range(3):
        remembering.resolve_function_type(operator.eq, (vector, vector), {})
    assert counting.asked == 4


def test_an_answer_brings_back_the_implementation_that_was_found_with_it() -> None:
    """Another function's flags may have another one made in between."""
    context = cpu_target.typing_context
    context.refresh()
    remembering = RememberingContext(context)
    question = (max, (types.float32, types.float32), {})
    signature = remembering.resolve_function_type(*question)
    function = context.resolve_value_type(max)
    found = function.get_impl_key(signature)
    flags = Flags()
    flags.boundscheck = True
    with ConfigStack().enter(flags):
        context.resolve_function_type(*question)
    assert function.get_impl_key(signature) != found
    assert remembering.resolve_function_type(*question) == signature
    assert function.get_impl_key(signature) == found
