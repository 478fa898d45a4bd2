# SPDX-License-Identifier: GPL-3.0-or-later
"""How kernels become LLVM's code where numba's own way costs too much.

Numba clears the room for what a called function returns, at the start of the function that calls. Where that is inlined
into a loop, as instructions of shaders are, the loop clears it in every round, for all calls that it does not make too.
The called function sets all of it before anybody reads it: kernels do not raise.

Numba makes machine code of what only other kernels call, too. Nobody runs it: callers have copies of their own, inlined
or beside them.
"""

from __future__ import annotations

from typing import Any

from llvmlite import ir
from numba import _dynfunc
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler_machinery import register_pass
from numba.core.lowering import Lower
from numba.core.typed_passes import BaseNativeLowering

from engine.runtime.bounds import is_checked, stand_at


def leave_uncleared(function: ir.Function) -> None:
    """Drop the stores that clear the slots which calls of a function return into."""
    calls = (one for block in function.blocks for one in block.instructions if isinstance(one, ir.CallInstr))
    returned_into = {id(call.args[0]) for call in calls if call.args}
    entry = function.entry_basic_block

    def clears(before: ir.Instruction | None, store: ir.Instruction) -> bool:
        is_first = isinstance(before, ir.AllocaInstr) and isinstance(store, ir.StoreInstr)
        return is_first and store.operands[1] is before and id(before) in returned_into

    instructions = list(entry.instructions)
    pairs = zip([None, *instructions], instructions, strict=False)
    entry.instructions[:] = [one for before, one in pairs if not clears(before, one)]


class _KernelLower(Lower):
    def lower_inst(self, inst: Any) -> None:
        if is_checked:
            stand_at(self.func_ir.func_id.func_qualname, inst.loc.line)
        super().lower_inst(inst)

    def post_lower(self) -> None:
        super().post_lower()
        leave_uncleared(self.function)


class CalleeLibrary(JITCodeLibrary):
    """Code for others to link, of which no machine code is made."""

    def _finalize_final_module(self) -> None:
        self._verify_declare_only_symbols()
        self._finalized = True


@register_pass(mutates_CFG=True, analysis_only=False)
class KernelLowering(BaseNativeLowering):
    """Numba's lowering, and no machine code of what only other kernels call."""

    _name = "kernel_lowering"

    @property
    def lowering_class(self) -> type[Lower]:
        return _KernelLower

    def run_pass(self, state: Any) -> bool:
        """Lower a function; one without wrappers, to which nothing but other functions leads, is not made to run."""
        if not state.flags.no_compile:
            return super().run_pass(state)
        name = state.func_id.func_qualname
        state.library = CalleeLibrary(state.targetctx.codegen(), name)
        super().run_pass(state)
        lowered = state["cr"]
        # They are found through a pointer that numba sets in machine code. No kernel has any.
        assert not lowered.env.consts, f"{name} refers to {lowered.env.consts}, which kernels cannot"
        # What numba's dispatcher asks for.
        entry = _dynfunc.make_function(lowered.fndesc.lookup_module(), name, "", 0, lowered.env, (state.library,))
        state["cr"] = lowered._replace(cfunc=entry)
        return True

