# SPDX-License-Identifier: GPL-3.0-or-later
"""Procedural textures as instructions; layout as in ops_math."""

import math

from engine.jit import kernel
from engine.kernels.shader.memory import read3, write3
from engine.kernels.shader.opcodes import TEXTURE_FIRST

OP_CHECKER = TEXTURE_FIRST + 0  # color, fac <- vector, color1, color2, scale


@kernel(forceinline=True)
def run_texture_op(opcode, code, pc, memory, tables):
    """Run the instruction at `pc`. `tables` is the pool of ramps and curves (ShaderArrays.tables)."""
    if opcode == OP_CHECKER:
        p = read3(memory, code[pc + 4])
        scale = memory[code[pc + 7]]
        # Cycles nudges the coordinate so that cells do not flicker where a surface lies on their boundary.
        x = int(math.floor((p[0] * scale + 0.000001) * 0.999999))
        y = int(math.floor((p[1] * scale + 0.000001) * 0.999999))
        z = int(math.floor((p[2] * scale + 0.000001) * 0.999999))
        if (x ^ y ^ z) & 1:
            memory[code[pc + 3]] = 1.0
            write3(memory, code[pc + 2], read3(memory, code[pc + 5]))
        else:
            memory[code[pc + 3]] = 0.0
            write3(memory, code[pc + 2], read3(memory, code[pc + 6]))
