# SPDX-License-Identifier: GPL-3.0-or-later
"""Patterns that few scenes have, as instructions of a linked kernel (`linked_patterns.py`); layout as in ops_math."""

from __future__ import annotations

import numpy as np
from numba import types

from engine.kernels.addresses import kernel_address
from engine.kernels.bsdf.linked import PATTERNS
from engine.kernels.bsdf.tables import link_kernel
from engine.kernels.memory import read3, write3
from engine.kernels.shader.opcodes import PATTERNS_FIRST
from engine.kernels.shader.procedural_gabor import gabor
from engine.kernels.shader.radial_tiling import tile_radially
from engine.kernels.vector import scale
from engine.runtime.bundle import FieldType, RowsType
from engine.runtime.jit import kernel

# value, phase, intensity <- vector, scale, frequency, anisotropy, angle, direction | 1 = through space
OP_GABOR = PATTERNS_FIRST + 0
# coordinates, number, width, rotation <- vector, sides, roundness | normalize
OP_RADIAL_TILING = PATTERNS_FIRST + 1


@kernel
def run_pattern_op(code, pc, memory):
    """Run the instruction at `pc`. Returns 0: a linked kernel returns something."""
    if code[pc] == OP_GABOR:
        value, phase, intensity = gabor(
            scale(read3(memory, code[pc + 5]), memory[code[pc + 6]]),
            code[pc + 11] != 0,
            memory[code[pc + 7]],
            memory[code[pc + 8]],
            memory[code[pc + 9]],
            read3(memory, code[pc + 10]),
        )
        memory[code[pc + 2]] = value
        memory[code[pc + 3]] = phase
        memory[code[pc + 4]] = intensity
    else:
        p = read3(memory, code[pc + 6])
        along, distance, number, width, rotation = tile_radially(
            p[0], p[1], memory[code[pc + 7]], memory[code[pc + 8]], code[pc + 9] != 0
        )
        write3(memory, code[pc + 2], (along, distance, 0.0))
        memory[code[pc + 3]] = number
        memory[code[pc + 4]] = width
        memory[code[pc + 5]] = rotation
    return np.int64(0)


def link_patterns() -> None:
    """Load or compile the kernel, and have all tables know it."""
    argument_types = (FieldType(types.int32, ()), types.int64, RowsType(types.float32, (), (4,)))
    link_kernel(PATTERNS, kernel_address(run_pattern_op, types.int64, *argument_types))
