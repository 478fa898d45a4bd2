# SPDX-License-Identifier: GPL-3.0-or-later
"""Operands of instructions: scalars and 3-vectors in a thread's memory (see engine.state.shaders)."""

from engine.runtime.jit import kernel


@kernel
def read3(memory, slot):
    """Three floats at `slot` as a tuple."""
    return (memory[slot], memory[slot + 1], memory[slot + 2])


@kernel
def write3(memory, slot, value):
    """Write a 3-tuple at `slot`."""
    memory[slot] = value[0]
    memory[slot + 1] = value[1]
    memory[slot + 2] = value[2]
