# SPDX-License-Identifier: GPL-3.0-or-later
"""Instructions on numbers, vectors and colours: each reads its operands, computes, writes its results.

Layout of an instruction at `pc`: opcode, length, outputs, inputs, immediates, in the order its entry in
engine/shaders/nodes_texture_math.py lists them.
"""

from engine.jit import kernel
from engine.kernels.shader.memory import read3, write3
from engine.kernels.shader.opcodes import MATH_FIRST

OP_CLAMP = MATH_FIRST + 0  # value <- value, min, max | is_range
OP_COMBINE_XYZ = MATH_FIRST + 1  # vector <- x, y, z
OP_INVERT = MATH_FIRST + 2  # color <- fac, color


@kernel(forceinline=True)
def run_math_op(opcode, code, pc, memory, tables):
    """Run the instruction at `pc`. `tables` is the pool of ramps and curves (ShaderArrays.tables)."""
    if opcode == OP_CLAMP:
        low = memory[code[pc + 4]]
        high = memory[code[pc + 5]]
        if code[pc + 6] != 0 and low > high:
            low, high = high, low
        memory[code[pc + 2]] = min(max(memory[code[pc + 3]], low), high)
    elif opcode == OP_COMBINE_XYZ:
        write3(memory, code[pc + 2], (memory[code[pc + 3]], memory[code[pc + 4]], memory[code[pc + 5]]))
    elif opcode == OP_INVERT:
        fac = memory[code[pc + 3]]
        color = read3(memory, code[pc + 4])
        keep = 1.0 - 2.0 * fac
        write3(memory, code[pc + 2], (fac + color[0] * keep, fac + color[1] * keep, fac + color[2] * keep))
