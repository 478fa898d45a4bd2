# SPDX-License-Identifier: GPL-3.0-or-later
"""Instructions before they have addresses: common subexpressions shared, unread ones dropped, registers assigned."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from engine.state.shaders import FIRST_REGISTER, SINK


@dataclass(frozen=True)
class Constant:
    """A folded value of one or three floats."""

    value: tuple[float, ...]

    @property
    def width(self) -> int:
        """Floats it takes in memory."""
        return len(self.value)


@dataclass(frozen=True)
class Register:
    """Output `output` of instruction `instruction`."""

    instruction: int
    output: int
    width: int


Value = Constant | Register


def is_zero(value: Value) -> bool:
    """Whether the value is constant and zero."""
    return isinstance(value, Constant) and not any(value.value)


@dataclass(frozen=True)
class Instruction:
    """See engine.state.shaders for the layout it will take."""

    opcode: int
    inputs: tuple[Value, ...]
    output_widths: tuple[int, ...]
    immediates: tuple[int, ...] = ()


class InstructionList:
    """Instructions of one program in dependency order; equal ones are stored once."""

    def __init__(self) -> None:
        self.instructions: list[Instruction] = []
        self._known: dict[Instruction, int] = {}

    def append(self, instruction: Instruction) -> tuple[Register, ...]:
        """Registers of the instruction's outputs, of the equal earlier one if there is one."""
        index = self._known.get(instruction)
        if index is None:
            index = len(self.instructions)
            self.instructions.append(instruction)
            self._known[instruction] = index
        return tuple(Register(index, k, width) for k, width in enumerate(instruction.output_widths))

    def forget(self) -> None:
        """Share nothing appended so far with what follows: the point has changed."""
        self._known.clear()

    def append_effect(self, instruction: Instruction) -> int:
        """Append an instruction that is run for its effect, never shared; returns its index."""
        self.instructions.append(instruction)
        return len(self.instructions) - 1


class ConstantPool:
    """Constants of all programs, equal ones shared."""

    def __init__(self) -> None:
        self.values: list[float] = []
        self._known: dict[bytes, int] = {}

    def index(self, constant: Constant) -> int:
        """Index of the constant's first float."""
        key = np.array(constant.value, np.float32).tobytes()
        at = self._known.get(key)
        if at is None:
            at = len(self.values)
            self.values.extend(constant.value)
            self._known[key] = at
        return at


class _Registers:
    """Free registers, lowest first."""

    def __init__(self) -> None:
        self._used: set[int] = set(range(FIRST_REGISTER))
        self.count = FIRST_REGISTER

    def take(self, width: int) -> int:
        slot = FIRST_REGISTER
        while any(slot + k in self._used for k in range(width)):
            slot += 1
        self._used.update(range(slot, slot + width))
        self.count = max(self.count, slot + width)
        return slot

    def release(self, slot: int, width: int) -> None:
        self._used.difference_update(range(slot, slot + width))


@dataclass
class Assembled:
    """Words of code; `constant_words` are those that hold an index into the constant pool, still without base."""

    words: list[int]
    constant_words: list[int]
    register_count: int


def assemble(instructions: Sequence[Instruction], roots: Iterable[int], pool: ConstantPool) -> Assembled:
    """Code of the instructions in `roots` and of all they read, in order.

    A register is free again once its last reader has run; never for that reader's own outputs, so that kernels may
    write before they have read everything.
    """
    needed: set[int] = set()
    pending = list(roots)
    while pending:
        index = pending.pop()
        if index not in needed:
            needed.add(index)
            pending.extend(v.instruction for v in instructions[index].inputs if isinstance(v, Register))
    order = sorted(needed)
    last_read: dict[tuple[int, int], int] = {}
    for index in order:
        for value in instructions[index].inputs:
            if isinstance(value, Register):
                last_read[value.instruction, value.output] = index
    registers = _Registers()
    slots: dict[tuple[int, int], int] = {}
    words: list[int] = []
    constant_words: list[int] = []
    for index in order:
        instruction = instructions[index]
        line = [instruction.opcode, 0]
        for output, width in enumerate(instruction.output_widths):
            slot = SINK
            if (index, output) in last_read:
                slot = slots[index, output] = registers.take(width)
            line.append(slot)
        for value in instruction.inputs:
            if isinstance(value, Constant):
                constant_words.append(len(words) + len(line))
                line.append(pool.index(value))
            else:
                line.append(slots[value.instruction, value.output])
        for value in set(instruction.inputs):
            if isinstance(value, Register) and last_read[value.instruction, value.output] == index:
                registers.release(slots[value.instruction, value.output], value.width)
        line.extend(instruction.immediates)
        line[1] = len(line)
        words.extend(line)
    return Assembled(words, constant_words, registers.count)
