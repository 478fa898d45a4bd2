# SPDX-License-Identifier: GPL-3.0-or-later
"""Slots that calls return into are not cleared; all others are."""

from llvmlite import ir

from engine.runtime.lowering import leave_uncleared


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
