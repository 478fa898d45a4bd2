# SPDX-License-Identifier: GPL-3.0-or-later
"""Instructions that read the shading point, and the few that glue programs together (conversions, weights).

Comments give each instruction as `outputs <- inputs | immediates`. `width` and `axis` displace the point for bump
mapping: axis 0 = not at all, 1 and 2 = along the footprint's axes by `width` times its radius.
"""

import math

from engine.kernels.bsdf.normals import safe_normal
from engine.kernels.constants import LUMINANCE_B, LUMINANCE_G, LUMINANCE_R
from engine.kernels.limits import at_least, clamp, clamp_unit
from engine.kernels.memory import read3, write3
from engine.kernels.motion import point_to_world
from engine.kernels.rounds import shape_at
from engine.kernels.shader.grids import sample_alpha, sample_grid
from engine.kernels.shader.light_path import camera_coordinate, is_of_world, light_path, object_float, window_coordinate
from engine.kernels.shader.normal_ops import bump, fresnel_dielectric, normal_map, vector_transform
from engine.kernels.shader.opcodes import DISPLACEMENT_FIRST, INPUT_FIRST
from engine.kernels.shader.ops_displacement import run_displacement_op
from engine.kernels.shader.ops_rounds import is_strand, run_round_op
from engine.kernels.shader.surface import (
    displaced_barycentrics,
    displaced_position,
    fetch_attribute,
    generated,
    orthogonal_tangent,
    radial_tangent,
    read_point,
    smooth_normal_object,
    to_object,
    unit_normal_to_object,
    uv_tangent_object,
)
from engine.kernels.vector import dot, normalize, scale, subtract, transform_point
from engine.runtime.jit import kernel
from engine.state.geometry import (
    ATTRIBUTE_COMPONENTS,
    ATTRIBUTE_DOMAIN,
    ATTRIBUTE_OFFSET,
    DOMAIN_GRID,
    DOMAIN_INSTANCE,
    INSTANCE_MESH,
    MESH_DEFAULT_COLOR,
    MESH_DEFAULT_UV,
    SHAPE_RIBBONS,
)
from engine.state.lanes import (
    POINT_FLAG_BACKFACING,
    POINT_FLAGS,
    POINT_INSTANCE,
    POINT_LIGHT,
    POINT_NG,
    POINT_NS,
    POINT_P,
    POINT_RAY_LENGTH,
    POINT_TANGENT,
    POINT_TIME,
    POINT_TRIANGLE,
    POINT_U,
    POINT_V,
    POINT_WO,
)
from engine.state.shaders import CAMERA_WORLD_TO_CAMERA

OP_COLOR_TO_FLOAT = INPUT_FIRST + 0  # float <- color
OP_VECTOR_TO_FLOAT = INPUT_FIRST + 1  # float <- vector
OP_FLOAT_TO_VECTOR = INPUT_FIRST + 2  # vector <- float
OP_MULTIPLY = INPUT_FIRST + 3  # float <- a, b
OP_ADD = INPUT_FIRST + 4  # float <- a, b
OP_MIX_WEIGHTS = INPUT_FIRST + 5  # first, second <- weight, fac
OP_MAPPING = INPUT_FIRST + 6  # vector <- vector, location, rotation, scale | type
OP_TRANSFORM_POINT = INPUT_FIRST + 7  # vector <- vector | table (3x4), normalize
OP_NORMAL_NODE = INPUT_FIRST + 8  # normal, dot <- normal, direction
OP_SATURATE = INPUT_FIRST + 9  # float <- float
OP_POSITION = INPUT_FIRST + 10  # vector <- width | axis
OP_NORMAL = INPUT_FIRST + 11  # vector <-
OP_TRUE_NORMAL = INPUT_FIRST + 12  # vector <-
OP_INCOMING = INPUT_FIRST + 13  # vector <-
OP_PARAMETRIC = INPUT_FIRST + 14  # vector <- width | axis
OP_BACKFACING = INPUT_FIRST + 15  # float <-
OP_GENERATED = INPUT_FIRST + 16  # vector <- width | axis
OP_OBJECT_COORDINATE = INPUT_FIRST + 17  # vector <- width | axis
OP_OBJECT_NORMAL = INPUT_FIRST + 18  # vector <- width | axis
OP_CAMERA_COORDINATE = INPUT_FIRST + 19  # vector <- width | axis
OP_WINDOW = INPUT_FIRST + 20  # vector <- width | axis
OP_REFLECTION = INPUT_FIRST + 21  # vector <-
OP_INSTANCER = INPUT_FIRST + 22  # vector <- | 0 = generated, 1 = uv
OP_ATTRIBUTE = INPUT_FIRST + 23  # vector, fac, alpha <- width | axis, slot (-1 UV, -2 colour), is_color
OP_LIGHT_PATH = INPUT_FIRST + 24  # float <- | LIGHT_PATH_*
OP_OBJECT_VECTOR = INPUT_FIRST + 25  # vector <- | 0 = location, 1 = colour
OP_OBJECT_FLOAT = INPUT_FIRST + 26  # float <- | OBJECT_*
OP_CAMERA_DATA = INPUT_FIRST + 27  # vector, depth, distance <-
OP_NORMAL_MAP = INPUT_FIRST + 30  # normal <- color, strength | space, tangent slot, uv slot (-1: render), bits, slot
OP_BUMP = INPUT_FIRST + 31  # normal <- h, hx, hy, strength, distance, normal, width | invert, BUMPED_*
OP_TANGENT = INPUT_FIRST + 32  # tangent <- | 0..2 radial axis or 3 = UV, tangent slot, uv slot
OP_FRESNEL = INPUT_FIRST + 33  # fac <- ior, normal
OP_LAYER_WEIGHT = INPUT_FIRST + 34  # fresnel, facing <- blend, normal
OP_VECTOR_TRANSFORM = INPUT_FIRST + 35  # vector <- vector | type, from, to
OP_LIGHT_FALLOFF = INPUT_FIRST + 36  # quadratic, linear, constant <- strength, smooth
OP_SET_NORMAL = INPUT_FIRST + 37  # <- normal (displacement as bump: the point's shading normal from here on)
OP_DOT = INPUT_FIRST + 39  # float <- a, b
OP_GRID = INPUT_FIRST + 40  # vector, fac, alpha <- default | slot, by splines; within a volume
OP_ROUND = INPUT_FIRST + 41  # float or vector <- | ROUND_*

#: Flags of OP_NORMAL_MAP: its green channel grows downwards; the normal of the tangents' frame is a unit vector.
NORMAL_MAP_GREEN_DOWN = 1
NORMAL_MAP_UNIT_FRAME = 2

#: Instead of a tangent slot: on curves the tangent is theirs.
TANGENT_OF_CURVES = -4

MAPPING_POINT = 0
MAPPING_TEXTURE = 1
MAPPING_VECTOR = 2
MAPPING_NORMAL = 3


@kernel
def safe_divide(a, b):
    """a / b, 0 where b is 0."""
    return a / b if b != 0.0 else 0.0 * a


@kernel
def _over_length(a):
    """Vector over its length: no number where that is zero, as in Cycles' Normal node."""
    return scale(a, 1.0 / math.sqrt(dot(a, a)))


@kernel
def map_vector(v, location, rotation, size, kind):
    """Mapping node: scale, rotate (XYZ Euler angles [rad]) and translate; TEXTURE is the inverse of POINT."""
    cx = math.cos(rotation[0])
    sx = math.sin(rotation[0])
    cy = math.cos(rotation[1])
    sy = math.sin(rotation[1])
    cz = math.cos(rotation[2])
    sz = math.sin(rotation[2])
    row_x = (cy * cz, sy * sx * cz - cx * sz, sy * cx * cz + sx * sz)
    row_y = (cy * sz, sy * sx * sz + cx * cz, sy * cx * sz - sx * cz)
    row_z = (-sy, cy * sx, cy * cx)
    if kind == MAPPING_TEXTURE:
        v = subtract(v, location)
        v = (
            row_x[0] * v[0] + row_y[0] * v[1] + row_z[0] * v[2],
            row_x[1] * v[0] + row_y[1] * v[1] + row_z[1] * v[2],
            row_x[2] * v[0] + row_y[2] * v[1] + row_z[2] * v[2],
        )
        return (safe_divide(v[0], size[0]), safe_divide(v[1], size[1]), safe_divide(v[2], size[2]))
    if kind == MAPPING_NORMAL:
        v = (safe_divide(v[0], size[0]), safe_divide(v[1], size[1]), safe_divide(v[2], size[2]))
        return normalize((dot(row_x, v), dot(row_y, v), dot(row_z, v)))
    v = (v[0] * size[0], v[1] * size[1], v[2] * size[2])
    v = (dot(row_x, v), dot(row_y, v), dot(row_z, v))
    if kind == MAPPING_POINT:
        return (v[0] + location[0], v[1] + location[1], v[2] + location[2])
    return v


@kernel
def table_transform(tables, at, p):
    """Affine 3x4 matrix at `tables[at]` applied to a point."""
    return (
        tables[at] * p[0] + tables[at + 1] * p[1] + tables[at + 2] * p[2] + tables[at + 3],
        tables[at + 4] * p[0] + tables[at + 5] * p[1] + tables[at + 6] * p[2] + tables[at + 7],
        tables[at + 8] * p[0] + tables[at + 9] * p[1] + tables[at + 10] * p[2] + tables[at + 11],
    )


@kernel
def default_slot(geometry, instance, column):
    """Slot number of the mesh's default attribute in a column of mesh_table, -1 = none."""
    if instance < 0:
        return -1
    return int(geometry.mesh_table[geometry.instance_table[instance, INSTANCE_MESH], column])


@kernel
def run_attribute(code, pc, memory, geometry, points, lane):
    """OP_ATTRIBUTE. Missing attributes are black; alpha is then 1, or 0 for a colour attribute, as in Cycles."""
    instance = points.integer[lane, POINT_INSTANCE]
    slot = code[pc + 7]
    if slot == -1:
        slot = default_slot(geometry, instance, MESH_DEFAULT_UV)
        if points.integer[lane, POINT_LIGHT] >= 0 and instance < 0:
            u = points.real[lane, POINT_U]
            v = points.real[lane, POINT_V]
            write3(memory, code[pc + 2], (1.0 - u - v, u, 0.0))
            return
    elif slot == -2:
        slot = default_slot(geometry, instance, MESH_DEFAULT_COLOR)
    u, v = displaced_barycentrics(geometry, points, lane, code[pc + 6], memory[code[pc + 5]])
    x, y, z, w, components = fetch_attribute(geometry, instance, points.integer[lane, POINT_TRIANGLE], slot, u, v)
    fac = x
    alpha = 1.0
    if components == 1:
        y = x
        z = x
    elif components >= 3:
        fac = (x + y + z) * (1.0 / 3.0)
        if components == 4:
            alpha = w
    elif components == 0 and code[pc + 8] != 0:
        alpha = 0.0
    write3(memory, code[pc + 2], (x, y, z))
    memory[code[pc + 3]] = fac
    memory[code[pc + 4]] = alpha


@kernel
def run_grid(code, pc, memory, geometry, points, lane):
    """OP_GRID: what a grid of the object holds at the point, else the object's own attribute, else the default."""
    instance, slot = points.integer[lane, POINT_INSTANCE], code[pc + 6]
    otherwise = memory[code[pc + 5]]
    x, y, z = otherwise, otherwise, otherwise
    alpha = 1.0 + 0.0 * otherwise
    if instance >= 0:
        row = geometry.instance_table[instance, INSTANCE_MESH] * geometry.attribute_count[0] + slot
        domain = geometry.attribute_table[row, ATTRIBUTE_DOMAIN]
        if domain == DOMAIN_GRID:
            p = to_object(geometry, instance, points.real[lane, POINT_TIME], read_point(points, lane, POINT_P))
            grid, is_smooth = geometry.attribute_table[row, ATTRIBUTE_OFFSET], code[pc + 7] != 0
            x, y, z = sample_grid(geometry.grids, grid, p, is_smooth)
            if geometry.attribute_table[row, ATTRIBUTE_COMPONENTS] == 4:
                # Colours are kept times their alpha.
                alpha = sample_alpha(geometry.grids, grid, p, is_smooth)
                if alpha > 1e-6 and alpha != 1.0:
                    x, y, z = x / alpha, y / alpha, z / alpha
        elif domain == DOMAIN_INSTANCE:
            x, y, z, _w, components = fetch_attribute(geometry, instance, -1, slot, 0.0, 0.0)
            if components == 1:
                y, z = x, x
    write3(memory, code[pc + 2], (x, y, z))
    memory[code[pc + 3]] = (x + y + z) * (1.0 / 3.0)
    memory[code[pc + 4]] = alpha


@kernel
def run_coordinate(opcode, code, pc, memory, geometry, points, lane, camera):
    """Instructions `vector <- width | axis`."""
    axis = code[pc + 4]
    width = memory[code[pc + 3]]
    instance = points.integer[lane, POINT_INSTANCE]
    time = points.real[lane, POINT_TIME]
    value = (0.0, 0.0, 0.0)
    if opcode == OP_POSITION:
        value = displaced_position(points, lane, axis, width)
    elif opcode == OP_GENERATED:
        value = generated(geometry, points, lane, axis, width)
    elif opcode == OP_OBJECT_COORDINATE:
        value = to_object(geometry, instance, time, displaced_position(points, lane, axis, width))
    elif opcode == OP_CAMERA_COORDINATE:
        value = camera_coordinate(camera, points, lane, displaced_position(points, lane, axis, width))
    elif opcode == OP_WINDOW:
        value = window_coordinate(camera, points, lane, displaced_position(points, lane, axis, width))
    elif opcode == OP_PARAMETRIC:
        u, v = displaced_barycentrics(geometry, points, lane, axis, width)
        value = (1.0 - u - v, u, 0.0)
    elif opcode == OP_OBJECT_NORMAL:
        if axis == 0 or instance < 0:
            value = unit_normal_to_object(geometry, instance, time, read_point(points, lane, POINT_NS))
        else:
            u, v = displaced_barycentrics(geometry, points, lane, axis, width)
            value = smooth_normal_object(geometry, points, lane, u, v)
            if points.integer[lane, POINT_FLAGS] & POINT_FLAG_BACKFACING:
                value = scale(value, -1.0)
    write3(memory, code[pc + 2], value)


@kernel
def tangent_of(code, pc, geometry, points, lane):
    """OP_TANGENT."""
    kind = code[pc + 3]
    if kind < 3:
        if code[pc + 4] == TANGENT_OF_CURVES and is_strand(geometry, points, lane):
            return normalize(read_point(points, lane, POINT_TANGENT))
        return radial_tangent(geometry, points, lane, kind)
    uv_slot = code[pc + 5]
    instance = points.integer[lane, POINT_INSTANCE]
    if uv_slot < 0:
        uv_slot = default_slot(geometry, instance, MESH_DEFAULT_UV)
    c = (0.0, 0.0, 0.0)
    if instance >= 0:
        c, sign = uv_tangent_object(geometry, points, lane, code[pc + 4], uv_slot)
        if sign != 0.0:
            c = orthogonal_tangent(geometry, points, lane, c)
    return c


@kernel
def run_light_falloff(code, pc, memory, distance):
    """OP_LIGHT_FALLOFF, of light that has come so far."""
    strength = memory[code[pc + 5]]
    smooth = memory[code[pc + 6]]
    squared = distance * distance
    quadratic = strength
    linear = strength
    constant = strength
    # Distant lights have no falloff to undo.
    if distance < 1e30:
        if smooth > 0.0:
            strength = strength * squared / (smooth + squared)
        quadratic = strength
        linear = strength * distance
        constant = strength * squared
    memory[code[pc + 2]] = quadratic
    memory[code[pc + 3]] = linear
    memory[code[pc + 4]] = constant


@kernel
def run_input_op(opcode, code, pc, memory, tables, geometry, points, lane, camera, pass_indices):
    """Run the instruction at `pc` for the point of `lane`; those most programs have, OP_NORMAL and OP_ATTRIBUTE, are
    the interpreter's own.
    """
    if opcode == OP_GRID:
        run_grid(code, pc, memory, geometry, points, lane)
    elif opcode == OP_ROUND:
        run_round_op(code, pc, memory, geometry, points, lane)
    elif opcode == OP_COLOR_TO_FLOAT:
        c = read3(memory, code[pc + 3])
        memory[code[pc + 2]] = LUMINANCE_R * c[0] + LUMINANCE_G * c[1] + LUMINANCE_B * c[2]
    elif opcode == OP_VECTOR_TO_FLOAT:
        c = read3(memory, code[pc + 3])
        memory[code[pc + 2]] = (c[0] + c[1] + c[2]) * (1.0 / 3.0)
    elif opcode == OP_FLOAT_TO_VECTOR:
        f = memory[code[pc + 3]]
        write3(memory, code[pc + 2], (f, f, f))
    elif opcode == OP_MULTIPLY:
        memory[code[pc + 2]] = memory[code[pc + 3]] * memory[code[pc + 4]]
    elif opcode == OP_ADD:
        memory[code[pc + 2]] = memory[code[pc + 3]] + memory[code[pc + 4]]
    elif opcode == OP_MIX_WEIGHTS:
        fac = clamp_unit(memory[code[pc + 5]])
        weight = memory[code[pc + 4]]
        memory[code[pc + 2]] = weight * (1.0 - fac)
        memory[code[pc + 3]] = weight * fac
    elif opcode == OP_TRANSFORM_POINT:
        c = table_transform(tables, code[pc + 4], read3(memory, code[pc + 3]))
        if code[pc + 5] != 0:
            c = normalize(c)
        write3(memory, code[pc + 2], c)
    elif opcode == OP_MAPPING:
        c = map_vector(
            read3(memory, code[pc + 3]),
            read3(memory, code[pc + 4]),
            read3(memory, code[pc + 5]),
            read3(memory, code[pc + 6]),
            code[pc + 7],
        )
        write3(memory, code[pc + 2], c)
    elif opcode == OP_NORMAL_NODE:
        direction = _over_length(read3(memory, code[pc + 5]))
        memory[code[pc + 3]] = dot(direction, _over_length(read3(memory, code[pc + 4])))
        write3(memory, code[pc + 2], direction)
    elif OP_POSITION <= opcode <= OP_WINDOW:
        if opcode == OP_TRUE_NORMAL:
            # A ribbon faces the ray.
            is_ribbon = shape_at(geometry, points.integer[lane, POINT_INSTANCE]) == SHAPE_RIBBONS
            write3(memory, code[pc + 2], read_point(points, lane, POINT_WO if is_ribbon else POINT_NG))
        elif opcode == OP_INCOMING:
            write3(memory, code[pc + 2], read_point(points, lane, POINT_WO))
        elif opcode == OP_BACKFACING:
            backfacing = points.integer[lane, POINT_FLAGS] & POINT_FLAG_BACKFACING
            memory[code[pc + 2]] = 1.0 if backfacing else 0.0
        else:
            run_coordinate(opcode, code, pc, memory, geometry, points, lane, camera)
    elif opcode == OP_REFLECTION:
        wo = read_point(points, lane, POINT_WO)
        if not is_of_world(points, lane):
            n = read_point(points, lane, POINT_NS)
            wo = subtract(scale(n, 2.0 * dot(n, wo)), wo)
        write3(memory, code[pc + 2], wo)
    elif opcode == OP_INSTANCER:
        instance = points.integer[lane, POINT_INSTANCE]
        c = (0.0, 0.0, 0.0)
        if instance >= 0:
            values = geometry.instance_values
            if code[pc + 3] == 0:
                c = (values[instance, 5], values[instance, 6], values[instance, 7])
            else:
                c = (values[instance, 8], values[instance, 9], 0.0)
        write3(memory, code[pc + 2], c)
    elif opcode == OP_LIGHT_PATH:
        memory[code[pc + 2]] = light_path(points, lane, code[pc + 3])
    elif opcode == OP_OBJECT_VECTOR:
        instance = points.integer[lane, POINT_INSTANCE]
        c = (0.0, 0.0, 0.0)
        if instance >= 0:
            if code[pc + 3] == 0:
                c = point_to_world(geometry, instance, points.real[lane, POINT_TIME], c)
            else:
                values = geometry.instance_values
                c = (values[instance, 1], values[instance, 2], values[instance, 3])
        write3(memory, code[pc + 2], c)
    elif opcode == OP_OBJECT_FLOAT:
        memory[code[pc + 2]] = object_float(geometry, points, lane, pass_indices, code[pc + 3])
    elif opcode == OP_CAMERA_DATA:
        p = transform_point(camera, CAMERA_WORLD_TO_CAMERA, read_point(points, lane, POINT_P))
        write3(memory, code[pc + 2], normalize(p))
        memory[code[pc + 3]] = p[2]
        memory[code[pc + 4]] = math.sqrt(dot(p, p))
    elif opcode == OP_NORMAL_MAP:
        uv_slot = code[pc + 7]
        if uv_slot < 0:
            uv_slot = default_slot(geometry, points.integer[lane, POINT_INSTANCE], MESH_DEFAULT_UV)
        color = read3(memory, code[pc + 3])
        if code[pc + 8] & NORMAL_MAP_GREEN_DOWN:
            color = (color[0], 1.0 - color[1], color[2])
        n = normal_map(
            geometry,
            points,
            lane,
            color,
            memory[code[pc + 4]],
            code[pc + 5],
            code[pc + 6],
            uv_slot,
            code[pc + 8] & NORMAL_MAP_UNIT_FRAME,
            code[pc + 9],
        )
        write3(memory, code[pc + 2], n)
    elif opcode == OP_BUMP:
        n = bump(
            geometry,
            points,
            lane,
            memory[code[pc + 3]],
            memory[code[pc + 4]],
            memory[code[pc + 5]],
            memory[code[pc + 6]],
            memory[code[pc + 7]] * (-1.0 if code[pc + 10] != 0 else 1.0),
            read3(memory, code[pc + 8]),
            memory[code[pc + 9]],
            code[pc + 11],
        )
        write3(memory, code[pc + 2], n)
    elif opcode == OP_TANGENT:
        c = tangent_of(code, pc, geometry, points, lane)
        write3(memory, code[pc + 2], c)
    elif opcode == OP_FRESNEL:
        eta = at_least(memory[code[pc + 3]], 1e-5)
        if points.integer[lane, POINT_FLAGS] & POINT_FLAG_BACKFACING:
            eta = 1.0 / eta
        cos_o = dot(read_point(points, lane, POINT_WO), read3(memory, code[pc + 4]))
        memory[code[pc + 2]] = fresnel_dielectric(cos_o, eta)
    elif opcode == OP_LAYER_WEIGHT:
        blend = memory[code[pc + 4]]
        cos_o = dot(read_point(points, lane, POINT_WO), read3(memory, code[pc + 5]))
        eta = at_least(1.0 - blend, 1e-5)
        if not points.integer[lane, POINT_FLAGS] & POINT_FLAG_BACKFACING:
            eta = 1.0 / eta
        memory[code[pc + 2]] = fresnel_dielectric(cos_o, eta)
        f = abs(cos_o)
        if blend != 0.5:
            blend = clamp(blend, 0.0, 1.0 - 1e-5)
            blend = 2.0 * blend if blend < 0.5 else 0.5 / (1.0 - blend)
            f = f**blend
        memory[code[pc + 3]] = 1.0 - f
    elif opcode == OP_VECTOR_TRANSFORM:
        c = vector_transform(
            geometry,
            camera,
            points.integer[lane, POINT_INSTANCE],
            points.real[lane, POINT_TIME],
            read3(memory, code[pc + 3]),
            code[pc + 4],
            code[pc + 5],
            code[pc + 6],
        )
        write3(memory, code[pc + 2], c)
    elif opcode == OP_LIGHT_FALLOFF:
        run_light_falloff(code, pc, memory, points.real[lane, POINT_RAY_LENGTH])
    elif opcode == OP_SATURATE:
        memory[code[pc + 2]] = clamp_unit(memory[code[pc + 3]])
    elif opcode == OP_DOT:
        memory[code[pc + 2]] = dot(read3(memory, code[pc + 3]), read3(memory, code[pc + 4]))
    elif opcode >= DISPLACEMENT_FIRST:
        run_displacement_op(opcode, code, pc, memory, geometry, points, lane)
    elif opcode == OP_SET_NORMAL:
        n = safe_normal(read3(memory, code[pc + 2]), read_point(points, lane, POINT_NS))
        points.real[lane, POINT_NS] = n[0]
        points.real[lane, POINT_NS + 1] = n[1]
        points.real[lane, POINT_NS + 2] = n[2]
