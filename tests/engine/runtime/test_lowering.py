# SPDX-License-Identifier: GPL-3.0-or-later
"""Slots that calls return into are not cleared; all others are. What only kernels call has no machine code."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from llvmlite import ir
from numba.core import event

from engine.runtime.jit import kernel
from engine.runtime.lowering import leave_uncleared


@kernel
def _called(x):
    return x + 1.0


@kernel
def _calling(x):
    return _called(x) * 2.0


class _Compiled(event.Listener):
    """Numba's results by the function's name."""

    def __init__(self) -> None:
        self.results: dict[str, Any] = {}

    def on_start(self, event: event.Event) -> None:
        pass

    def on_end(self, event: event.Event) -> None:
        for result in event.data["dispatcher"].overloads.values():
            self.results[result.fndesc.qualname] = result


def test_only_what_python_calls_has_machine_code(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("NEURALGUIDE_KERNEL_CACHE", str(tmp_path))
    with event.install_listener("numba:compile", _Compiled()) as compiled:
        assert _calling(np.float32(1.0)) == 4.0
    address = {
        name: result.library.get_pointer_to_function(result.fndesc.llvm_func_name)
        for name, result in compiled.results.items()
    }
    assert address["_calling"] != 0 and address["_called"] == 0


def test_only_slots_that_calls_return_into_stay_uncleared() -> None:
    word = ir.IntType(64)
    module = ir.Module()
    callee = ir.Function(module, ir.FunctionType(ir.VoidType(), [word.as_pointer(), word]), "callee")
    function = ir.Function(module, ir.FunctionType(word, [word]), "caller")
    builder = ir.IRBuilder(function.append_basic_block())
    slots = []
    for _ in range(3):
        slots.append(builder.alloca(word))
        builder.store(word(None), slots[-1])
    returned, read, written_later = slots
    builder.store(word(7), returned)
    builder.branch(function.append_basic_block())
    builder.position_at_end(function.blocks[1])
    builder.call(callee, [returned, function.args[0]])
    builder.call(callee, [written_later, function.args[0]])
    builder.ret(builder.add(builder.load(returned), builder.load(read)))

    leave_uncleared(function)

    stores = [one for one in function.entry_basic_block.instructions if isinstance(one, ir.StoreInstr)]
    assert [(store.operands[1], store.operands[0].constant) for store in stores] == [(read, 0), (returned, 7)]
