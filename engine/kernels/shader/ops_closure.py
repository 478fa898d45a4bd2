# SPDX-License-Identifier: GPL-3.0-or-later
"""Closure instructions: each adds its lobes, emission, transparency or AOV to the lane's closures.

They have no outputs. The first input is always the weight that Mix and Add Shader nodes give the closure; one of zero
adds nothing. Those that add lobes are in the table of closures, `engine/kernels/bsdf/lobes.py`.
"""

import math

from engine.kernels.bsdf.lobe import View
from engine.kernels.bsdf.lobes import INSTRUCTIONS, run_instruction
from engine.kernels.bsdf.no_lobes import add_emission, add_holdout, add_transparent
from engine.kernels.bsdf.no_normal import drop_lobes
from engine.kernels.limits import clamp_unit
from engine.kernels.memory import read3
from engine.kernels.shader.opcodes import CLOSURE_FIRST, VOLUME_FIRST
from engine.kernels.shader.ops_volume import run_volume_op
from engine.kernels.shader.surface import read_point
from engine.kernels.vector import scale
from engine.runtime.jit import kernel
from engine.state.lanes import (
    POINT_FLAG_BACKFACING,
    POINT_FLAGS,
    POINT_NG,
    POINT_NS,
    POINT_RADIUS,
    POINT_RANDOM,
    POINT_RAY_FLAGS,
    POINT_TANGENT,
    POINT_WO,
    RAY_CAMERA,
    RAY_PASSES_DONE,
)

OP_EMISSION = CLOSURE_FIRST + 0  # weight, color, strength
OP_TRANSPARENT = CLOSURE_FIRST + 1  # weight, color
OP_HOLDOUT = CLOSURE_FIRST + 2  # weight
OP_ALPHA = CLOSURE_FIRST + 3  # weight, alpha: what alpha lets through
OP_AOV = CLOSURE_FIRST + 4  # weight, value or colour; first column, 1 or 3 values, columns of a lane
#: From here on they add lobes.
LOBES_FIRST = CLOSURE_FIRST + 5


def opcode(name: str) -> int:
    """Number of an instruction in the table of closures."""
    return LOBES_FIRST + list(INSTRUCTIONS).index(name)


#: The first operand of all others is a normal.
_FIBRES_FIRST, _FIBRES_LAST = opcode("HAIR"), opcode("HUANG_OUTSIDE")


@kernel
def _add_aov(closures, lane, memory, code, pc):
    """Add to the lane's columns of an AOV; a colour has an alpha of one, by which the film counts samples."""
    at = lane * code[pc + 6] + code[pc + 4]
    source = code[pc + 3]
    count = code[pc + 5]
    for k in range(count):
        closures.aovs[at + k] += memory[source + k]
    if count > 1:
        closures.aovs[at + count] += 1.0


@kernel(forceinline=True)
def run_closure_op(opcode, code, pc, memory, points, closures, tables, lane):
    """Run the instruction at `pc`."""
    w = memory[code[pc + 2]]
    if w == 0.0:
        return
    if opcode == OP_EMISSION:
        color = read3(memory, code[pc + 3])
        add_emission(closures, lane, scale(color, w * memory[code[pc + 4]]))
        return
    if opcode == OP_TRANSPARENT:
        add_transparent(closures, lane, scale(read3(memory, code[pc + 3]), w))
        return
    if opcode == OP_ALPHA:
        through = w * (1.0 - clamp_unit(memory[code[pc + 3]]))
        add_transparent(closures, lane, (through, through, through))
        return
    if opcode == OP_HOLDOUT:
        add_holdout(closures, lane, (w, w, w))
        return
    if opcode == OP_AOV:
        # AOVs are written for what the camera sees, up to the surface that is opaque enough.
        if points.integer[lane, POINT_RAY_FLAGS] & (RAY_CAMERA | RAY_PASSES_DONE) == RAY_CAMERA:
            _add_aov(closures, lane, memory, code, pc)
        return
    if opcode >= VOLUME_FIRST:
        run_volume_op(opcode, closures, lane, w, memory, code, pc)
        return
    is_seen = points.integer[lane, POINT_RAY_FLAGS] & RAY_CAMERA != 0
    view = View(
        read_point(points, lane, POINT_WO),
        read_point(points, lane, POINT_NG),
        read_point(points, lane, POINT_NS),
        (points.integer[lane, POINT_FLAGS] & POINT_FLAG_BACKFACING) != 0,
        read_point(points, lane, POINT_TANGENT),
        points.real[lane, POINT_RANDOM],
        points.real[lane, POINT_RADIUS] if is_seen else -1.0,
    )
    first = closures.count[lane]
    run_instruction(opcode - LOBES_FIRST, closures, tables, lane, view, w, memory, code, pc)
    if opcode < _FIBRES_FIRST or opcode > _FIBRES_LAST:
        n = read3(memory, code[pc + 3])
        if math.isnan(n[0] + n[1] + n[2]):
            drop_lobes(closures, lane, first)
