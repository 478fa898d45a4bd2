# SPDX-License-Identifier: GPL-3.0-or-later
"""LLVM is given the same code as by all of numba's passes."""

import re
from collections.abc import Callable
from typing import Any

import numpy as np
from numba.core import types
from numba.core.compiler import CompilerBase, DefaultPassBuilder, Flags
from numba.core.registry import cpu_target

from engine.runtime.jit import kernel
from engine.runtime.pipeline import OURS, KernelCompiler, has_closures

_NAME = re.compile(r"_ZN\w+|numba\.dynamic\.globals\.\w+|inttoptr \(i64 \d+")


class _AllPasses(CompilerBase):
    def define_pipelines(self) -> list[Any]:
        passes: Any = DefaultPassBuilder.define_nopython_pipeline(self.state)
        passes.passes = [(OURS.get(one, one), why) for one, why in passes.passes]
        passes.finalize()
        return [passes]


@kernel
def _limited(x, low):
    return max(x, low)


def _by_branches(values, n):
    total, best = np.float32(0.0), (np.float32(0.0), np.int64(-1))
    for i in range(n):
        value = _limited(values[i], np.float32(0.5))
        if value > best[0]:
            best = (value, i)
        elif value < -1.0:
            break
        while total < 10.0:
            total += value * value
    return total + best[0], best[1]


def _by_another(values, n):
    def square(value):
        return value * value

    return square(values[n - 1])


def _compiled(function: Callable[..., Any], compiler: type[CompilerBase]) -> str:
    flags = Flags()
    flags.nrt = has_closures(function.__code__)
    flags.error_model = "numpy"
    arguments = (types.float32[::1], types.int64)
    pipeline = compiler(cpu_target.typing_context, cpu_target.target_context, None, arguments, None, flags, {})
    cpu_target.typing_context.refresh()
    cpu_target.target_context.refresh()
    code = pipeline.compile_extra(function).library.get_llvm_str()
    names: dict[str, int] = {}
    return _NAME.sub(lambda name: f"name{names.setdefault(name[0], len(names))}", code)


def test_the_code_is_that_of_all_passes() -> None:
    assert not has_closures(_by_branches.__code__)
    assert _compiled(_by_branches, KernelCompiler) == _compiled(_by_branches, _AllPasses)


def test_a_function_that_defines_others_is_compiled() -> None:
    assert has_closures(_by_another.__code__)
    assert "define" in _compiled(_by_another, KernelCompiler)
