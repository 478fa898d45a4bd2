# SPDX-License-Identifier: GPL-3.0-or-later
"""The interpreter of shader programs (instruction layout: engine.state.shaders)."""

from engine.kernels.bsdf.closures import append_closure, reset_closures
from engine.kernels.bsdf.kinds import (
    CLOSURE_IS_BEHIND_DIFFUSE,
    CLOSURE_IS_LOST,
    CLOSURE_IS_ON_STRAND,
    CLOSURE_NO_BUMP_CORRECTION,
    CLOSURE_NO_REFLECTIVE_CAUSTICS,
    CLOSURE_NO_REFRACTIVE_CAUSTICS,
    DIFFUSE,
)
from engine.kernels.memory import write3
from engine.kernels.prefetch import ask_for_closures, ask_for_point, lane_ahead
from engine.kernels.shader.ahead import ask_for_coordinates, ask_for_texels
from engine.kernels.shader.linked_patterns import run_linked_pattern
from engine.kernels.shader.opcodes import (
    CLOSURE_FIRST,
    IMAGE_FIRST,
    MATH_FIRST,
    PATTERNS_FIRST,
    RAYS_FIRST,
    TEXTURE_FIRST,
)
from engine.kernels.shader.ops_closure import run_closure_op
from engine.kernels.shader.ops_image import run_image_op
from engine.kernels.shader.ops_input import OP_ATTRIBUTE, OP_NORMAL, OP_SET_NORMAL, run_attribute, run_input_op
from engine.kernels.shader.ops_math import run_math_op
from engine.kernels.shader.ops_rays import run_ray_op
from engine.kernels.shader.ops_texture import run_texture_op
from engine.kernels.shader.surface import read_point
from engine.kernels.shader.world_image import ask_for_world, shade_world
from engine.kernels.vector import store
from engine.runtime.jit import kernel
from engine.state.lanes import (
    POINT_FLAG_STRAND,
    POINT_FLAGS,
    POINT_NS,
    POINT_PROGRAM,
    POINT_RAY_FLAGS,
    RAY_DIFFUSE_ANCESTOR,
)
from engine.state.shaders import (
    MODE_CLOSURES,
    MODE_EMISSION,
    MODE_MASK,
    MODE_MEDIUM,
    MODE_NO_REFLECTIVE_CAUSTICS,
    MODE_NO_REFRACTIVE_CAUSTICS,
    PROGRAM_END,
    PROGRAM_FLAGS,
    PROGRAM_IS_LAMBERTIAN,
    PROGRAM_NO_BUMP_CORRECTION,
    PROGRAM_START,
    PROGRAM_WORLD_IMAGE,
    VALUE_LAMBERTIAN,
)

#: How many lanes ahead points are asked for, then the coordinates of textures; texels a little later.
_POINTS_AHEAD = 12
_COORDINATES_AHEAD = 8


@kernel
def _left_out(mode):
    """Flags of closures for the caustics that a mode leaves out."""
    caustics = 0
    if mode & MODE_NO_REFLECTIVE_CAUSTICS:
        caustics |= CLOSURE_NO_REFLECTIVE_CAUSTICS
    if mode & MODE_NO_REFRACTIVE_CAUSTICS:
        caustics |= CLOSURE_NO_REFRACTIVE_CAUSTICS
    return caustics


@kernel
def evaluate_shaders(shaders, geometry, tables, points, closures, lanes, lane_count, memory, mode):
    """Run the program of each listed lane at its point and fill the lane's closures.

    Parameters
    ----------
    shaders : ShaderArrays
    geometry : GeometryArrays
    tables : BsdfTables
    points : ShadePoints
        POINT_PROGRAM selects the program. For the background P is the ray's direction, wo its opposite, instance -1.
    closures : Closures
        Row `lane` is reset, then filled.
    lanes : int32 (>= lane_count,)
    memory : ShaderMemory
        `engine.state.shaders.allocate_memory(shaders)`, one a thread.
    mode : int
        MODE_CLOSURES, MODE_EMISSION, MODE_TRANSPARENCY or MODE_MEDIUM, plus MODE_NO_*_CAUSTICS.
    """
    code, programs, values = shaders.code, shaders.programs, shaders.program_values
    pool = shaders.tables
    camera = shaders.camera
    pass_indices = shaders.program_pass_index
    images = shaders.images
    pixels_byte = shaders.pixels_byte
    pixels_float = shaders.pixels_float
    floats = memory.floats
    column = 2 * (mode & MODE_MASK)
    caustics = _left_out(mode)
    for k in range(lane_count):
        lane = lanes[k]
        ask_for_point(points, lanes[min(k + _POINTS_AHEAD, lane_count - 1)])
        ahead = lane_ahead(lanes, k, lane_count)
        ask_for_closures(closures, ahead)
        if column == 2 * MODE_CLOSURES:
            ask_for_coordinates(programs, geometry, points, lanes[min(k + _COORDINATES_AHEAD, lane_count - 1)])
            ask_for_texels(programs, images, pixels_byte, pixels_float, geometry, points, ahead)
        if column == 2 * MODE_EMISSION:
            ask_for_world(programs, images, pixels_byte, pixels_float, pool, points, ahead)
        program = points.integer[lane, POINT_PROGRAM]
        flags = (points.integer[lane, POINT_FLAGS] & POINT_FLAG_STRAND) * (CLOSURE_IS_ON_STRAND // POINT_FLAG_STRAND)
        if points.integer[lane, POINT_RAY_FLAGS] & RAY_DIFFUSE_ANCESTOR:
            flags |= caustics | CLOSURE_IS_BEHIND_DIFFUSE
        facts = programs[program, PROGRAM_FLAGS]
        if facts & PROGRAM_NO_BUMP_CORRECTION:
            flags |= CLOSURE_NO_BUMP_CORRECTION
        ns = read_point(points, lane, POINT_NS)
        reset_closures(closures, lane, ns, flags)
        if facts & PROGRAM_IS_LAMBERTIAN and column != 2 * MODE_MEDIUM:
            if column == 2 * MODE_CLOSURES:
                weight = (
                    values[program, VALUE_LAMBERTIAN],
                    values[program, VALUE_LAMBERTIAN + 1],
                    values[program, VALUE_LAMBERTIAN + 2],
                )
                append_closure(closures, lane, DIFFUSE, weight, ns)
            continue
        if column == 2 * MODE_EMISSION and programs[program, PROGRAM_WORLD_IMAGE] != 0:
            shade_world(programs, values, images, pixels_byte, pixels_float, pool, points, closures, lane)
            continue
        pc = programs[program, PROGRAM_START + column]
        end = programs[program, PROGRAM_END + column]
        while pc < end:
            opcode = code[pc]
            if opcode >= PATTERNS_FIRST:
                run_linked_pattern(tables, code, pc, floats)
            elif opcode >= TEXTURE_FIRST:
                run_texture_op(opcode, code, pc, floats, pool)
            elif opcode >= MATH_FIRST:
                run_math_op(opcode, code, pc, floats, pool)
            elif opcode >= IMAGE_FIRST:
                run_image_op(opcode, code, pc, floats, images, pixels_byte, pixels_float, pool)
            elif opcode >= CLOSURE_FIRST:
                run_closure_op(opcode, code, pc, floats, points, closures, tables, lane)
            elif opcode == OP_NORMAL:
                write3(floats, code[pc + 2], read_point(points, lane, POINT_NS))
            elif opcode == OP_ATTRIBUTE:
                run_attribute(code, pc, floats, geometry, points, lane)
            elif opcode >= RAYS_FIRST:
                run_ray_op(memory, shaders, geometry, points, lane, pc, column == 2 * MODE_CLOSURES)
            else:
                run_input_op(opcode, code, pc, floats, pool, geometry, points, lane, camera, pass_indices)
                if opcode == OP_SET_NORMAL:
                    # Displacement shown as bump is the surface's own shape: no lobe is bumped against it.
                    store(closures.ns, lane, read_point(points, lane, POINT_NS))
            pc += code[pc + 1]
        if closures.flags[lane] & CLOSURE_IS_LOST:
            closures.count[lane] = 0
