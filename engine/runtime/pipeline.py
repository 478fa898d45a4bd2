# SPDX-License-Identifier: GPL-3.0-or-later
"""Which of numba's passes a kernel goes through, and how they are run.

A first render compiles hundreds of functions, and most of that time is Python's. Kernels are plain functions of
scalars, tuples and arrays: what numba does for closures, context managers, array expressions and overloads finds
nothing there. Between passes numba looks for the variables' lifetimes; kernels' passes need these once, before
lowering. The code that LLVM is given is the same.
"""

from __future__ import annotations

from types import CodeType
from typing import Any

from numba.core import errors, transforms
from numba.core.compiler import CompilerBase, DefaultPassBuilder
from numba.core.compiler_lock import global_compiler_lock
from numba.core.compiler_machinery import PassManager, _pass_registry
from numba.core.ir_utils import legalize_single_scope
from numba.core.typed_passes import InlineOverloads, NativeLowering, NopythonRewrites, NopythonTypeInference
from numba.core.untyped_passes import (
    FindLiterallyCalls,
    InlineClosureLikes,
    InlineInlinables,
    LiteralPropagationSubPipelinePass,
    LiteralUnroll,
    MakeFunctionToJitFunction,
    RewriteDynamicRaises,
    WithLifting,
)

from engine.runtime.inference import KernelTypeInference
from engine.runtime.lowering import KernelLowering

#: Passes of ours, by those of numba that they stand for.
OURS = {NativeLowering: KernelLowering, NopythonTypeInference: KernelTypeInference}
#: What looks for functions within functions, array expressions, functions that numba's own library inlines, `with`,
#: `raise` and `literally`.
_NEVER = frozenset(
    {
        FindLiterallyCalls,
        InlineClosureLikes,
        InlineInlinables,
        InlineOverloads,
        LiteralPropagationSubPipelinePass,
        LiteralUnroll,
        MakeFunctionToJitFunction,
        NopythonRewrites,
        RewriteDynamicRaises,
        WithLifting,
    }
)


def has_closures(code: CodeType) -> bool:
    """Whether a function defines others, comprehensions among them in Python 3.11."""
    return any(isinstance(constant, CodeType) for constant in code.co_consts)


class KernelPasses(PassManager):
    """Passes that are run one after the other, without what numba looks up between them for its events and checks."""

    @global_compiler_lock
    def _runPass(self, index: int, one: Any, state: Any) -> None:
        one.analysis = self._analysis
        with errors.new_error_context("Pass {name}", name=one.name()):  # type: ignore[attr-defined]
            one.run_initialization(state)
            one.run_pass(state)
            one.run_finalizer(state)
        if _pass_registry.get(one.__class__).mutates_CFG:
            state.func_ir.blocks = transforms.canonicalize_cfg(state.func_ir.blocks)
        assert legalize_single_scope(state.func_ir.blocks), f"several scopes after {one.name()}"


class KernelCompiler(CompilerBase):
    """Numba's compiler with the passes that kernels need."""

    def define_pipelines(self) -> list[PassManager]:
        """Numba's passes, some left out, some ours; a function that defines others goes through all."""
        numbas: Any = DefaultPassBuilder.define_nopython_pipeline(self.state)
        passes = [(OURS.get(one, one), why) for one, why in numbas.passes]
        if not has_closures(self.state.func_id.code):
            numbas = KernelPasses("kernel")
            passes = [(one, why) for one, why in passes if one not in _NEVER]
        numbas.passes = passes
        numbas.finalize()
        return [numbas]
