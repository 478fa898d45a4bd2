# SPDX-License-Identifier: GPL-3.0-or-later
"""Perturbed normals (normal maps, bump), Fresnel and changes of space."""

import math

from engine.kernels.limits import at_least, clamp_unit
from engine.kernels.motion import direction_to_object, direction_to_world, point_to_object, point_to_world
from engine.kernels.shader.ops_displacement import attribute_here, undisplaced_footprint
from engine.kernels.shader.surface import (
    blended_object_normal,
    footprint_axis,
    read_point,
    unit_normal_to_object,
    unit_normal_to_world,
    uv_tangent_object,
)
from engine.kernels.vector import (
    add,
    cross,
    dot,
    negate,
    normalize,
    scale,
    subtract,
    transform_direction,
    transform_normal,
    transform_point,
)
from engine.runtime.jit import kernel
from engine.state.lanes import (
    POINT_FLAG_BACKFACING,
    POINT_FLAGS,
    POINT_INSTANCE,
    POINT_NG,
    POINT_NS,
    POINT_RADIUS,
    POINT_TIME,
)
from engine.state.shaders import CAMERA_TO_WORLD, CAMERA_WORLD_TO_CAMERA

SPACE_TANGENT = 0
SPACE_OBJECT = 1
SPACE_WORLD = 2
SPACE_BLENDER_OBJECT = 3
SPACE_BLENDER_WORLD = 4

TRANSFORM_VECTOR = 0
TRANSFORM_POINT = 1
TRANSFORM_NORMAL = 2
FROM_WORLD = 0
FROM_OBJECT = 1
FROM_CAMERA = 2

#: Spaces of a bump.
BUMPED_IN_WORLD = -2
BUMPED_IN_OBJECT = -1


@kernel
def fresnel_dielectric(cos_o, eta):
    """Unpolarised reflectance of a dielectric of relative index `eta` at cosine `cos_o`; 1 at total reflection."""
    c = abs(cos_o)
    g = eta * eta - 1.0 + c * c
    if g <= 0.0:
        return 1.0
    g = math.sqrt(g)
    a = (g - c) / (g + c)
    b = (c * (g + c) - 1.0) / (c * (g - c) + 1.0)
    return 0.5 * a * a * (1.0 + b * b)


@kernel
def normal_map(geometry, points, lane, color, strength, space, tangent_slot, uv_slot, has_unit_frame, normal_slot):
    """Normal Map node: `color` as a normal in tangent, object or world space, blended by `strength`.

    `has_unit_frame`: the normal between those of the corners is normalised, as from Blender 5.1 on. `normal_slot`:
    normals of a displaced mesh before, -1 = as they are.
    """
    ns = read_point(points, lane, POINT_NS)
    instance = points.integer[lane, POINT_INSTANCE]
    time = points.real[lane, POINT_TIME]
    backfacing = points.integer[lane, POINT_FLAGS] & POINT_FLAG_BACKFACING
    x = 2.0 * (color[0] - 0.5)
    y = 2.0 * (color[1] - 0.5)
    z = 2.0 * (color[2] - 0.5)
    n = (x, y, z)
    if space == SPACE_TANGENT:
        if instance < 0:
            return ns
        tangent, sign = uv_tangent_object(geometry, points, lane, tangent_slot, uv_slot)
        if sign == 0.0:
            return ns
        normal = blended_object_normal(geometry, points, lane)
        if normal_slot >= 0:
            before, has_some = attribute_here(geometry, points, lane, normal_slot)
            if has_some and dot(before, before) > 0.0:
                normal = before
        if has_unit_frame:
            normal = normalize(normal)
        x *= strength
        y *= strength
        s = clamp_unit(strength)
        z = 1.0 + (z - 1.0) * s
        bitangent = scale(cross(normal, tangent), sign)
        n = add(add(scale(tangent, x), scale(bitangent, y)), scale(normal, z))
        n = unit_normal_to_world(geometry, instance, time, normalize(n))
        if backfacing:
            n = negate(n)
    else:
        if space == SPACE_BLENDER_OBJECT or space == SPACE_BLENDER_WORLD:
            n = (x, -y, -z)
        if space == SPACE_OBJECT or space == SPACE_BLENDER_OBJECT:
            n = unit_normal_to_world(geometry, instance, time, n)
        else:
            n = normalize(n)
        if backfacing:
            n = negate(n)
        if strength != 1.0:
            n = normalize(add(ns, scale(subtract(n, ns), at_least(strength, 0.0))))
    # Of what is no number too: `bsdf/no_normal.py` knows what becomes of that.
    return n if dot(n, n) != 0.0 else ns


@kernel
def bump(geometry, points, lane, h, hx, hy, strength, distance, normal, width, slot):
    """Bump node: the surface raised by height times distance, heights given at P and at its two displaced points.

    `slot`: BUMPED_IN_*, or the slot of positions before displacement: raised in object space, as the surface was then.

    References: Mikkelsen 2010, "Bump Mapping Unparametrized Surfaces on the GPU"; `width` [footprint radii].
    """
    ng = read_point(points, lane, POINT_NG)
    instance = points.integer[lane, POINT_INSTANCE]
    time = points.real[lane, POINT_TIME]
    radius = points.real[lane, POINT_RADIUS]
    n = normal
    if not radius > 0.0:
        return n
    dx = footprint_axis(ng, 1)
    dy = footprint_axis(ng, 2)
    if slot != BUMPED_IN_WORLD and instance >= 0:
        n = unit_normal_to_object(geometry, instance, time, n)
        dx = direction_to_object(geometry, instance, time, dx)
        dy = direction_to_object(geometry, instance, time, dy)
        if slot >= 0:
            before = undisplaced_footprint(geometry, points, lane, slot, 1)
            if dot(before, before) > 0.0:
                dx = before
                dy = undisplaced_footprint(geometry, points, lane, slot, 2)
    rx = cross(dy, n)
    ry = cross(n, dx)
    determinant = dot(dx, rx)
    gradient = add(scale(rx, (hx - h) / radius), scale(ry, (hy - h) / radius))
    signed_distance = distance if determinant >= 0.0 else -distance
    raised = subtract(scale(n, width * abs(determinant)), scale(gradient, signed_distance))
    squared = dot(raised, raised)
    # A height that is no number makes such a normal.
    if squared != 0.0:
        strength = at_least(strength, 0.0)
        raised = scale(raised, 1.0 / math.sqrt(squared))
        n = normalize(add(scale(raised, strength), scale(n, 1.0 - strength)))
    if slot != BUMPED_IN_WORLD and instance >= 0:
        n = unit_normal_to_world(geometry, instance, time, n)
    return n


@kernel
def vector_transform(geometry, camera, instance, time, v, kind, source, target):
    """Vector Transform node: world, object and camera space, as vector, point or normal."""
    if source == target:
        return v
    if source == FROM_OBJECT:
        if instance >= 0:
            if kind == TRANSFORM_NORMAL:
                v = unit_normal_to_world(geometry, instance, time, v)
            elif kind == TRANSFORM_VECTOR:
                v = direction_to_world(geometry, instance, time, v)
            else:
                v = point_to_world(geometry, instance, time, v)
    elif source == FROM_CAMERA:
        if kind == TRANSFORM_NORMAL:
            v = normalize(transform_normal(camera, CAMERA_WORLD_TO_CAMERA, v))
        elif kind == TRANSFORM_VECTOR:
            v = transform_direction(camera, CAMERA_TO_WORLD, v)
        else:
            v = transform_point(camera, CAMERA_TO_WORLD, v)
    if target == FROM_OBJECT:
        if instance >= 0:
            if kind == TRANSFORM_NORMAL:
                v = unit_normal_to_object(geometry, instance, time, v)
            elif kind == TRANSFORM_VECTOR:
                v = direction_to_object(geometry, instance, time, v)
            else:
                v = point_to_object(geometry, instance, time, v)
    elif target == FROM_CAMERA:
        if kind == TRANSFORM_NORMAL:
            v = normalize(transform_normal(camera, CAMERA_TO_WORLD, v))
        elif kind == TRANSFORM_VECTOR:
            v = transform_direction(camera, CAMERA_WORLD_TO_CAMERA, v)
        else:
            v = transform_point(camera, CAMERA_WORLD_TO_CAMERA, v)
    return v
