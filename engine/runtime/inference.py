# SPDX-License-Identifier: GPL-3.0-or-later
"""How the types of kernels' variables are found where numba's own way costs too much.

Numba asks a dozen templates, in turn, what `float32 + float32` is, at each place where it is written and in each round
of its search: a quarter of compiling. The answer depends on the operator, the types and the flags of the function that
asks, so it is kept.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any

from numba.core import types
from numba.core.compiler_machinery import register_pass
from numba.core.typed_passes import NopythonTypeInference
from numba.core.typing import Context

#: Types of arguments, the values of literals left out, for which answers are kept.
_SCALARS = (types.Number, types.Boolean)


class RememberingContext(Context):
    """Numba's typing context itself, but for answers that are kept.

    Parameters
    ----------
    context : numba.core.typing.Context
        Whose state this one shares.
    ask : callable, optional
        Answers what is not known; numba's own way if not given.
    """

    __slots__ = ("_answers", "_ask")

    def __init__(self, context: Any, ask: Callable[..., Any] | None = None) -> None:
        self.__dict__ = context.__dict__
        self._ask = context.resolve_function_type if ask is None else ask
        self._answers: dict[Any, Any] = {}

    def resolve_function_type(self, func: Any, args: Any, kws: Any) -> Any:
        """The signature of a call, as numba's context finds it."""
        known = self._lookup_global(func)
        function: Any = func if known is None else known
        if kws or not isinstance(function, types.Function) or not all(_is_scalar(one) for one in args):
            return self._ask(func, args, kws)
        question = (function, *args)
        if question in self._answers:
            signature, implementation = self._answers[question]
            # Numba compiles what was found last, and somebody with other flags may have asked since.
            function._impl_keys[signature.args] = implementation
            return signature
        signature = self._ask(func, args, kws)
        if signature is not None and signature.args in function._impl_keys:
            self._answers[question] = signature, function._impl_keys[signature.args]
        return signature


def _is_scalar(argument: Any) -> bool:
    return isinstance(types.unliteral(argument), _SCALARS)  # type: ignore[attr-defined]


@cache
def _remembering(context: Any, _flags: str) -> RememberingContext:
    return RememberingContext(context)


@register_pass(mutates_CFG=True, analysis_only=False)
class KernelTypeInference(NopythonTypeInference):
    """Numba's search for types, by a context that remembers."""

    _name = "kernel_type_inference"

    def run_pass(self, state: Any) -> bool:
        """Find the types of a function's variables."""
        context = state.typingctx
        state.typingctx = _remembering(context, state.flags.summary())
        try:
            found: bool = super().run_pass(state)
        finally:
            state.typingctx = context
        return found
