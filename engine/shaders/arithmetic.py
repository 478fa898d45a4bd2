# SPDX-License-Identifier: GPL-3.0-or-later
"""Values of a program in the making: folded where their operands are constants, else instructions."""

from __future__ import annotations

from engine.kernels.shader import ops_input
from engine.shaders.folding import fold
from engine.shaders.pools import ScenePools
from engine.shaders.program import Constant, Instruction, InstructionList, Value
from engine.shaders.table import COLOR, FLOAT, SocketType

ZERO = Constant((0.0,))
ONE = Constant((1.0,))

#: Luminance of the channels of Rec.709.
_LUMINANCE = (0.2126390, 0.7151687, 0.0721923)


class Arithmetic:
    """Appends instructions to `code`, where their results are not known already."""

    def __init__(self, pools: ScenePools) -> None:
        self._pools = pools
        self.code = InstructionList()

    def append(self, instruction: Instruction, is_varying: bool) -> tuple[Value, ...]:
        """Append an instruction, or fold it."""
        constant = all(isinstance(value, Constant) for value in instruction.inputs)
        if constant and not is_varying:
            return fold(instruction, self._pools.tables())
        return self.code.append(instruction)

    def convert(self, value: Value, source: SocketType, target: SocketType) -> Value:
        """A value on a socket of another type: colours become luminance, vectors their mean, floats repeat."""
        luminance = self._pools.luminance
        if source.width == target.width:
            return value
        if target is FLOAT:
            if isinstance(value, Constant):
                weights = (luminance or _LUMINANCE) if source is COLOR else (1.0 / 3.0,) * 3
                return Constant((float(sum(w * x for w, x in zip(weights, value.value, strict=True))),))
            if source is COLOR and luminance is not None:
                return self.code.append(Instruction(ops_input.OP_DOT, (value, Constant(luminance)), (1,)))[0]
            opcode = ops_input.OP_COLOR_TO_FLOAT if source is COLOR else ops_input.OP_VECTOR_TO_FLOAT
            return self.code.append(Instruction(opcode, (value,), (1,)))[0]
        if isinstance(value, Constant):
            return Constant(value.value * 3)
        return self.code.append(Instruction(ops_input.OP_FLOAT_TO_VECTOR, (value,), (3,)))[0]

    def multiply(self, a: Value, b: Value) -> Value:
        """Product of two scalars."""
        if isinstance(a, Constant) and isinstance(b, Constant):
            return Constant((a.value[0] * b.value[0],))
        for x, y in ((a, b), (b, a)):
            if x == ONE:
                return y
            if x == ZERO:
                return ZERO
        return self.code.append(Instruction(ops_input.OP_MULTIPLY, (a, b), (1,)))[0]

    def add(self, a: Value, b: Value) -> Value:
        """Sum of two scalars."""
        if isinstance(a, Constant) and isinstance(b, Constant):
            return Constant((a.value[0] + b.value[0],))
        if a == ZERO:
            return b
        if b == ZERO:
            return a
        return self.code.append(Instruction(ops_input.OP_ADD, (a, b), (1,)))[0]

    def mix_weights(self, weight: Value, factor: Value) -> tuple[Value, Value]:
        """What a Mix Shader hands on of a scalar weight: to its first shader, and to its second."""
        if isinstance(factor, Constant):
            f = min(max(factor.value[0], 0.0), 1.0)
            return self.multiply(weight, Constant((1.0 - f,))), self.multiply(weight, Constant((f,)))
        first, second = self.code.append(Instruction(ops_input.OP_MIX_WEIGHTS, (weight, factor), (1, 1)))
        return first, second

    def saturate(self, value: Value) -> Value:
        """Scalar clamped to [0, 1]."""
        if isinstance(value, Constant):
            return Constant((min(max(value.value[0], 0.0), 1.0),))
        return self.code.append(Instruction(ops_input.OP_SATURATE, (value,), (1,)))[0]
