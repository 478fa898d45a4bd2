# SPDX-License-Identifier: GPL-3.0-or-later
"""Instructions of displacement: offsets that its nodes give, and where displaced surfaces were before.

Comments give each instruction as `outputs <- inputs | immediates`.
"""

from engine.kernels.memory import read3, write3
from engine.kernels.motion import direction_to_object, direction_to_world, normal_to_world, point_to_world
from engine.kernels.shader.opcodes import DISPLACEMENT_FIRST
from engine.kernels.shader.surface import (
    barycentric_slopes,
    edges,
    fetch_attribute,
    read_point,
    unit_normal_to_object,
    uv_tangent_object,
)
from engine.kernels.vector import add, cross, dot, negate, normalize, scale, subtract
from engine.runtime.jit import kernel
from engine.state.geometry import INSTANCE_MESH, MESH_DEFAULT_UV
from engine.state.lanes import (
    POINT_FLAG_BACKFACING,
    POINT_FLAGS,
    POINT_INSTANCE,
    POINT_NS,
    POINT_P,
    POINT_TIME,
    POINT_TRIANGLE,
    POINT_U,
    POINT_V,
)

OP_DISPLACEMENT = DISPLACEMENT_FIRST + 0  # vector <- height, midlevel, scale, normal | in object space
OP_VECTOR_DISPLACEMENT = DISPLACEMENT_FIRST + 1  # vector <- vector, midlevel, scale | space, tangent slot, uv slot
OP_UNDISPLACE = DISPLACEMENT_FIRST + 2  # position <- | slots of positions and of normals: the point is as it was
OP_SET_POSITION = DISPLACEMENT_FIRST + 3  # <- position

#: Spaces of a vector displacement.
DISPLACED_IN_TANGENT = 0
DISPLACED_IN_OBJECT = 1
DISPLACED_IN_WORLD = 2


@kernel
def vector_attribute(geometry, points, lane, slot, u, v):
    """A vector of the mesh on the point's triangle, and whether the mesh has it."""
    instance, triangle = points.integer[lane, POINT_INSTANCE], points.integer[lane, POINT_TRIANGLE]
    x, y, z, _w, components = fetch_attribute(geometry, instance, triangle, slot, u, v)
    return (x, y, z), components == 3


@kernel
def attribute_here(geometry, points, lane, slot):
    """A vector of the mesh at the point, and whether the mesh has it."""
    return vector_attribute(geometry, points, lane, slot, points.real[lane, POINT_U], points.real[lane, POINT_V])


@kernel
def undisplaced_footprint(geometry, points, lane, slot, axis):
    """What the unit axis of the footprint is before displacement, in object space; backwards on back faces."""
    du, dv = barycentric_slopes(geometry, points, lane, axis)
    a, _ = vector_attribute(geometry, points, lane, slot, 0.0, 0.0)
    b, _ = vector_attribute(geometry, points, lane, slot, 1.0, 0.0)
    c, _ = vector_attribute(geometry, points, lane, slot, 0.0, 1.0)
    return add(scale(subtract(b, a), du), scale(subtract(c, a), dv))


@kernel
def undisplace(geometry, points, lane, slot, normal_slot):
    """Put a point where it was before displacement, with the smooth normal that it had."""
    instance = points.integer[lane, POINT_INSTANCE]
    time = points.real[lane, POINT_TIME]
    p, has_position = attribute_here(geometry, points, lane, slot)
    if instance < 0 or not has_position:
        return
    p = point_to_world(geometry, instance, time, p)
    n, has_normal = attribute_here(geometry, points, lane, normal_slot)
    for k in range(3):
        points.real[lane, POINT_P + k] = p[k]
    if has_normal and dot(n, n) > 0.0:
        n = normalize(normal_to_world(geometry, instance, time, n))
        if points.integer[lane, POINT_FLAGS] & POINT_FLAG_BACKFACING:
            n = negate(n)
        for k in range(3):
            points.real[lane, POINT_NS + k] = n[k]


@kernel
def vector_displacement(geometry, points, lane, offset, space, tangent_slot, uv_slot):
    """An offset in tangent space (tangent, normal, bitangent), object or world space, in world space."""
    instance = points.integer[lane, POINT_INSTANCE]
    if space == DISPLACED_IN_WORLD or instance < 0:
        return offset
    time = points.real[lane, POINT_TIME]
    if space == DISPLACED_IN_TANGENT:
        normal = unit_normal_to_object(geometry, instance, time, read_point(points, lane, POINT_NS))
        tangent, sign = uv_tangent_object(geometry, points, lane, tangent_slot, uv_slot)
        if sign == 0.0:
            # Without a UV map, along the triangle's first edge.
            tangent, _ = edges(geometry, instance, points.integer[lane, POINT_TRIANGLE], time)
            tangent = normalize(direction_to_object(geometry, instance, time, tangent))
            sign = sign + 1.0
        bitangent = scale(normalize(cross(normal, tangent)), sign)
        offset = add(add(scale(tangent, offset[0]), scale(normal, offset[1])), scale(bitangent, offset[2]))
    return direction_to_world(geometry, instance, time, offset)


@kernel
def run_displacement_op(opcode, code, pc, memory, geometry, points, lane):
    """Run the instruction at `pc`."""
    instance = points.integer[lane, POINT_INSTANCE]
    if opcode == OP_DISPLACEMENT:
        n = read3(memory, code[pc + 6])
        height = (memory[code[pc + 3]] - memory[code[pc + 4]]) * memory[code[pc + 5]]
        if code[pc + 7] != 0 and instance >= 0:
            time = points.real[lane, POINT_TIME]
            n = unit_normal_to_object(geometry, instance, time, n)
            n = direction_to_world(geometry, instance, time, n)
        write3(memory, code[pc + 2], scale(n, height))
    elif opcode == OP_VECTOR_DISPLACEMENT:
        uv_slot = code[pc + 8]
        if uv_slot < 0 and instance >= 0:
            uv_slot = int(geometry.mesh_table[geometry.instance_table[instance, INSTANCE_MESH], MESH_DEFAULT_UV])
        middle = memory[code[pc + 4]]
        c = read3(memory, code[pc + 3])
        c = scale((c[0] - middle, c[1] - middle, c[2] - middle), memory[code[pc + 5]])
        c = vector_displacement(geometry, points, lane, c, code[pc + 6], code[pc + 7], uv_slot)
        write3(memory, code[pc + 2], c)
    elif opcode == OP_UNDISPLACE:
        write3(memory, code[pc + 2], read_point(points, lane, POINT_P))
        undisplace(geometry, points, lane, code[pc + 3], code[pc + 4])
    elif opcode == OP_SET_POSITION:
        p = read3(memory, code[pc + 2])
        for k in range(3):
            points.real[lane, POINT_P + k] = p[k]
