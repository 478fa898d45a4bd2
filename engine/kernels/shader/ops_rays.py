# SPDX-License-Identifier: GPL-3.0-or-later
"""Instructions that trace rays, as far as they trace none, those that read what rays have met, and Wireframe.

Where rays are traced `engine.wavefront.node_rays` runs them. Comments give each instruction as
`outputs <- inputs | immediates`. `number` keeps the random numbers of a program's nodes apart.
"""

import numpy as np

from engine.kernels.memory import read3, write3
from engine.kernels.motion import point_to_world, triangle_at
from engine.kernels.shader.opcodes import RAYS_FIRST
from engine.kernels.shader.surface import displaced_position, fetch_attribute, footprint_axis, read_point
from engine.kernels.vector import cross, dot, length, scale, subtract
from engine.runtime.jit import kernel
from engine.state.geometry import INSTANCE_FLAG_BAKED, INSTANCE_FLAGS, INSTANCE_MESH, MESH_SHAPE, SHAPE_TRIANGLES
from engine.state.lanes import (
    POINT_INSTANCE,
    POINT_NG,
    POINT_NS,
    POINT_RADIUS,
    POINT_TIME,
    POINT_TRIANGLE,
    POINT_WO,
)

# color, ao <- color, distance, normal | samples, OCCLUSION_*, number
OP_OCCLUSION = RAYS_FIRST + 0
# normal <- radius, normal | samples, number
OP_BEVEL = RAYS_FIRST + 1
# is hit, is self, distance, position, normal, hit, place <- position, direction, length, width | is local
# (hit: bits of instance and triangle; place: barycentrics)
OP_RAYCAST = RAYS_FIRST + 2
# vector, fac, alpha <- hit, place | slot
OP_HIT_ATTRIBUTE = RAYS_FIRST + 3
# float <- size, width | axis, 1 = size in pixels
OP_WIREFRAME = RAYS_FIRST + 4

#: Rays go below the surface; meet the object alone; and go as far as the world says.
OCCLUSION_INSIDE = 1
OCCLUSION_LOCAL = 2
OCCLUSION_OF_WORLD = 4


@kernel
def write_occlusion(code, pc, memory, free):
    """Outputs of OP_OCCLUSION; `free` is the part of the hemisphere where rays meet nothing."""
    write3(memory, code[pc + 2], scale(read3(memory, code[pc + 4]), free))
    memory[code[pc + 3]] = free


@kernel
def write_raycast(code, pc, memory, is_self, distance, position, normal, hit):
    """Outputs of OP_RAYCAST; `hit` is instance, triangle and barycentrics, instance -1: nothing was hit."""
    instance, triangle, u, v = hit
    memory[code[pc + 2]] = 1.0 if instance >= 0 else 0.0
    memory[code[pc + 3]] = 1.0 if is_self else 0.0
    memory[code[pc + 4]] = distance
    write3(memory, code[pc + 5], position)
    write3(memory, code[pc + 6], normal)
    write3(memory, code[pc + 7], (np.int32(instance).view(np.float32), np.int32(triangle).view(np.float32), 0.0))
    write3(memory, code[pc + 8], (u, v, 0.0))


@kernel
def write_missed(code, pc, memory):
    """Outputs of OP_RAYCAST where the ray meets nothing: its own length, and zeros."""
    zero = (0.0, 0.0, 0.0)
    write_raycast(code, pc, memory, False, memory[code[pc + 11]], zero, zero, (np.int32(-1), np.int32(-1), 0.0, 0.0))


@kernel
def run_hit_attribute(code, pc, memory, geometry):
    """OP_HIT_ATTRIBUTE: what is missing is black, and where nothing was hit alpha is zero too, as in Cycles."""
    instance = np.float32(memory[code[pc + 5]]).view(np.int32)
    triangle = np.float32(memory[code[pc + 5] + 1]).view(np.int32)
    place = code[pc + 6]
    x, y, z, w, components = fetch_attribute(
        geometry, np.int64(instance), np.int64(triangle), code[pc + 7], memory[place], memory[place + 1]
    )
    fac, alpha = x, 1.0
    if instance < 0:
        alpha = 0.0
    if components == 1:
        y, z = x, x
    elif components > 1:
        fac = (x + y + z) * (1.0 / 3.0)
        if components == 4:
            alpha = w
    write3(memory, code[pc + 2], (x, y, z))
    memory[code[pc + 3]] = fac
    memory[code[pc + 4]] = alpha


@kernel
def run_untraced(opcode, code, pc, memory, geometry, points, lane):
    """Run the instruction at `pc` where no rays are traced: nothing is occluded, rounded or hit."""
    if opcode == OP_OCCLUSION:
        write_occlusion(code, pc, memory, 1.0)
    elif opcode == OP_BEVEL:
        write3(memory, code[pc + 2], read_point(points, lane, POINT_NS))
    elif opcode == OP_RAYCAST:
        write_missed(code, pc, memory)
    else:
        run_hit_attribute(code, pc, memory, geometry)


@kernel
def _pixel_width(points, lane):
    """Mean width of the footprint, seen along the ray [m]."""
    ng, wo = read_point(points, lane, POINT_NG), read_point(points, lane, POINT_WO)
    radius = points.real[lane, POINT_RADIUS]
    total = 0.0
    for axis in range(1, 3):
        along = scale(footprint_axis(ng, axis), radius)
        total += 0.5 * length(subtract(along, scale(wo, dot(along, wo))))
    return total


@kernel
def is_on_edge(a, b, p, half_width):
    """Whether `p` is less than half a width from the line through two corners."""
    edge = subtract(b, a)
    across = cross(edge, subtract(p, b))
    return dot(across, across) < dot(edge, edge) * (half_width * half_width)


@kernel
def run_wireframe(code, pc, memory, geometry, points, lane):
    """OP_WIREFRAME: whether the point is nearer than half the size to an edge of its triangle."""
    memory[code[pc + 2]] = 0.0
    instance, triangle = points.integer[lane, POINT_INSTANCE], points.integer[lane, POINT_TRIANGLE]
    if instance < 0 or triangle < 0:
        return
    mesh = geometry.instance_table[instance, INSTANCE_MESH]
    if geometry.mesh_table[mesh, MESH_SHAPE] != SHAPE_TRIANGLES:
        return
    half_width = 0.5 * memory[code[pc + 3]]
    if code[pc + 6] != 0:
        half_width *= _pixel_width(points, lane)
    time = points.real[lane, POINT_TIME]
    p = displaced_position(points, lane, code[pc + 5], memory[code[pc + 4]])
    a, b, c = triangle_at(geometry, mesh, triangle, time)
    if not geometry.instance_table[instance, INSTANCE_FLAGS] & INSTANCE_FLAG_BAKED:
        a = point_to_world(geometry, instance, time, a)
        b = point_to_world(geometry, instance, time, b)
        c = point_to_world(geometry, instance, time, c)
    if is_on_edge(c, a, p, half_width) or is_on_edge(a, b, p, half_width) or is_on_edge(b, c, p, half_width):
        memory[code[pc + 2]] = 1.0


@kernel
def run_ray_op(memory, shaders, geometry, points, lane, pc, is_shading):
    """Run the instruction at `pc`: rays are traced where a surface is shaded, if its scene traces any.

    As in Cycles, whoever looks for light, through a surface or for a displacement, traces none.
    """
    code, floats = shaders.code, memory.floats
    opcode = code[pc]
    if opcode == OP_WIREFRAME:
        run_wireframe(code, pc, floats, geometry, points, lane)
    elif is_shading and memory.traces[0] != 0 and opcode != OP_HIT_ATTRIBUTE:
        memory.ray_ops.trace_op(memory, memory.rays, shaders, geometry, points, lane, pc)
    else:
        run_untraced(opcode, code, pc, floats, geometry, points, lane)
