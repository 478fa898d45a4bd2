# SPDX-License-Identifier: GPL-3.0-or-later
"""Start of shadow rays on triangles that are shaded smooth.

Where light comes in flat, a coarse mesh shows its triangles: the shading normal still sees the light and the triangle
does not. Shadow rays then start on the surface that the normals mean, a little above the triangle (or below, for light
from behind).

The height and where it is used are Cycles', so that its pictures come out; the idea is old.
References: Hanika 2021, "Hacking the Shadow Terminator" (Ray Tracing Gems II, chapter 4), for the linear envelope.
"""

from engine.kernels.constants import FAR
from engine.kernels.motion import direction_to_world, normals_at, triangle_at
from engine.kernels.surface import offset_origin, ray_start
from engine.kernels.vector import add, dot, length, negate, normalize, scale, subtract
from engine.runtime.jit import kernel
from engine.state.geometry import (
    INSTANCE_FLAG_BAKED,
    INSTANCE_FLAGS,
    INSTANCE_MESH,
    MESH_FIRST_NORMAL,
    VALUE_TERMINATOR,
)


@kernel
def _tangent_height(corner, p, first, second, n):
    """How far the plane of normal `n` through `corner`, lifted clear of the other two, is above `p`; at least 0."""
    lift = max(dot(subtract(first, corner), n), dot(subtract(second, corner), n), 0.0)
    return max(dot(subtract(corner, p), n) + lift, 0.0)


@kernel
def smooth_offset(geometry, instance, triangle, u, v, ng, time):
    """From a point on a triangle to the smooth surface above it, on the side of `ng` (world space)."""
    mesh = geometry.instance_table[instance, INSTANCE_MESH]
    n0, n1, n2 = normals_at(geometry, mesh, geometry.mesh_table[mesh, MESH_FIRST_NORMAL], triangle, time)
    v0, v1, v2 = triangle_at(geometry, mesh, triangle, time)
    w = 1.0 - u - v
    p = add(add(scale(v0, w), scale(v1, u)), scale(v2, v))
    n = add(add(scale(n0, w), scale(n1, u)), scale(n2, v))
    lift = n
    if not geometry.instance_table[instance, INSTANCE_FLAGS] & INSTANCE_FLAG_BAKED:
        lift = direction_to_world(geometry, instance, time, n)

    # The parabola over the triangle whose slope at every edge's ends is that of the normals.
    a = dot(subtract(n2, n0), subtract(v0, v2))
    b = dot(subtract(n2, n1), subtract(v1, v2))
    c = dot(subtract(n1, n0), subtract(v1, v0))
    height = 0.5 * (a * w * (w - 1.0) + (a + b + c) * w * u + b * u * (u - 1.0))

    # Or the lowest of the planes of the three corners' normals, whichever is farther from the triangle.
    if dot(lift, ng) > 0.0:
        plane = min(
            _tangent_height(v0, p, v1, v2, n0), _tangent_height(v1, p, v0, v2, n1), _tangent_height(v2, p, v0, v1, n2)
        )
        height = max(plane, height)
    else:
        n0 = negate(n0)
        n1 = negate(n1)
        n2 = negate(n2)
        plane = min(
            _tangent_height(v0, p, v1, v2, n0), _tangent_height(v1, p, v0, v2, n1), _tangent_height(v2, p, v0, v1, n2)
        )
        height = min(-plane, height)
    return scale(lift, height)


@kernel
def shadow_ray(geometry, instance, triangle, u, v, p, ng, ns, wi, distance, offset, in_place, time):
    """Ray from a point on a surface, or within a medium (`instance` -1), to a light.

    Parameters
    ----------
    p, ng, ns : tuple of 3 float32
        The point, and its normals turned to the viewer.
    wi, distance : tuple of 3 float32, float32
        Direction and distance of the light from p; from `FAR` on it is infinitely far away.
    offset : float32 [m]
        Step off the surface that clears the rounding error of p.
    in_place : bool
        Whether it is to start in place, and to skip the triangle.
    time : float32 in [0, 1], of the shutter

    Returns
    -------
    origin, direction : tuple of 3 float32
    distance : float32
    in_place : bool
        False where it starts above the triangle, and is to come down on it.
    """
    if instance < 0:
        return p, wi, distance, in_place
    cutoff = 0.0 * offset
    mesh = geometry.instance_table[instance, INSTANCE_MESH]
    if geometry.mesh_table[mesh, MESH_FIRST_NORMAL] >= 0:
        cutoff = geometry.instance_values[instance, VALUE_TERMINATOR]
    amount = 0.0 * offset
    if cutoff > 0.0:
        cos_s = dot(ns, wi)
        facing = ng if cos_s >= 0.0 else negate(ng)
        cos_s = abs(cos_s)
        cos_g = dot(facing, wi)
        # Whole below the cutoff, fading out above it.
        amount = 2.0 - (cos_g + cos_s) / cutoff if cos_s < cutoff else 1.0 - cos_g / cutoff
        if amount > 0.0:
            lift = scale(smooth_offset(geometry, instance, triangle, u, v, facing, time), min(amount, 1.0))
            # Above the triangle, so that it shadows what reaches the smooth surface from below.
            in_place = in_place and cos_g > 0.0
            origin = add(p, lift)
            if not in_place:
                origin = add(origin, scale(facing, offset))
            if distance < FAR:
                to_light = subtract(add(p, scale(wi, distance)), origin)
                distance = length(to_light)
                wi = normalize(to_light)
            return origin, wi, distance, in_place
    if in_place:
        return ray_start(geometry, instance, triangle, p, wi, time), wi, distance, True
    return offset_origin(p, ng, wi, offset), wi, distance, False
