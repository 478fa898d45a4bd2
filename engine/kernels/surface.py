# SPDX-License-Identifier: GPL-3.0-or-later
"""Points on surfaces: position, normals, rounding error, and the ray's start that clears it."""

import numpy as np

from engine.kernels.motion import move_surface, normals_at, triangle_at
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
from engine.state.geometry import (
    INSTANCE_FLAG_BAKED,
    INSTANCE_FLAG_MIRRORED,
    INSTANCE_FLAG_MOVING,
    INSTANCE_FLAGS,
    INSTANCE_MATERIAL_OFFSET,
    INSTANCE_MESH,
    MESH_FIRST_NORMAL,
)
from engine.state.lanes import (
    POINT_FLAG_BACKFACING,
    POINT_FLAGS,
    POINT_INSTANCE,
    POINT_LIGHT,
    POINT_NG,
    POINT_NS,
    POINT_P,
    POINT_TIME,
    POINT_TRIANGLE,
    POINT_U,
    POINT_V,
    POINT_WO,
)

#: Bound on the relative rounding error of a point interpolated from a triangle's vertices: gamma(7) of pbrt (Pharr et
#: al. 2023, section 6.8), four times over for the transform and for Embree's own distance.
RELATIVE_ERROR = np.float32(4.0 * 7.0 * 2.0**-24)
#: Least cosine by which `skipped_distance` divides: rays that only graze a surface skip no more than this says.
_LEAST_COSINE = np.float32(1e-4)


@kernel
def surface_point(geometry, instance, triangle, u, v, time):
    """Where on a triangle: position, geometric and shading normal (world, unit, not turned to the viewer), error.

    Returns
    -------
    p, ng, ns : 3-tuples
    error : float32 [m], bound on the rounding error of p
    """
    mesh = geometry.instance_table[instance, INSTANCE_MESH]
    v0, v1, v2 = triangle_at(geometry, mesh, triangle, time)
    w = 1.0 - u - v
    p = (
        w * v0[0] + u * v1[0] + v * v2[0],
        w * v0[1] + u * v1[1] + v * v2[1],
        w * v0[2] + u * v1[2] + v * v2[2],
    )
    extent = max(
        max(abs(v0[0]), abs(v1[0]), abs(v2[0])),
        max(abs(v0[1]), abs(v1[1]), abs(v2[1])),
        max(abs(v0[2]), abs(v1[2]), abs(v2[2])),
    )
    ng = cross(subtract(v1, v0), subtract(v2, v0))
    flags = geometry.instance_table[instance, INSTANCE_FLAGS]
    first_normal = geometry.mesh_table[mesh, MESH_FIRST_NORMAL]
    ns = ng
    if first_normal >= 0:
        n0, n1, n2 = normals_at(geometry, mesh, first_normal, triangle, time)
        ns = (
            w * n0[0] + u * n1[0] + v * n2[0],
            w * n0[1] + u * n1[1] + v * n2[1],
            w * n0[2] + u * n1[2] + v * n2[2],
        )
    if flags & INSTANCE_FLAG_BAKED:
        if flags & INSTANCE_FLAG_MIRRORED:
            ng = negate(ng)
            if first_normal < 0:
                ns = ng
    elif flags & INSTANCE_FLAG_MOVING:
        p, ng, ns, extent = move_surface(geometry, instance, time, p, extent, ng, ns)
    else:
        widest = transform_direction(geometry.transforms, instance, (extent, extent, extent))
        extent = max(abs(widest[0]), abs(widest[1]), abs(widest[2]))
        p = transform_point(geometry.transforms, instance, p)
        extent = max(extent, abs(p[0]), abs(p[1]), abs(p[2]))
        ng = transform_normal(geometry.inverses, instance, ng)
        ns = transform_normal(geometry.inverses, instance, ns)
    ng = normalize(ng)
    if first_normal >= 0:
        ns = normalize(ns)
        if dot(ns, ns) < 0.5:
            ns = ng
    else:
        ns = ng
    return p, ng, ns, extent * RELATIVE_ERROR


@kernel
def prepare_point(geometry, points, lane, instance, triangle, u, v, direction, time):
    """Fill the geometric part of a point to shade; returns its error bound [m]."""
    p, ng, ns, error = surface_point(geometry, instance, triangle, u, v, time)
    flags = 0
    if dot(ng, direction) > 0.0:
        ng = negate(ng)
        ns = negate(ns)
        flags = POINT_FLAG_BACKFACING
    real = points.real
    for k in range(3):
        real[lane, POINT_P + k] = p[k]
        real[lane, POINT_WO + k] = -direction[k]
        real[lane, POINT_NG + k] = ng[k]
        real[lane, POINT_NS + k] = ns[k]
    real[lane, POINT_U] = u
    real[lane, POINT_V] = v
    real[lane, POINT_TIME] = time
    points.integer[lane, POINT_INSTANCE] = instance
    points.integer[lane, POINT_TRIANGLE] = triangle
    points.integer[lane, POINT_FLAGS] = flags
    points.integer[lane, POINT_LIGHT] = -1
    return error


@kernel
def program_of(geometry, instance, triangle):
    """Shader program of a triangle of an instance."""
    offset = geometry.instance_table[instance, INSTANCE_MATERIAL_OFFSET]
    return geometry.instance_materials[offset + geometry.material_slots[triangle]]


@kernel
def offset_origin(p, ng, direction, offset):
    """Start of a ray leaving p: off the surface by `offset`, on the side it leaves to."""
    side = offset if dot(ng, direction) >= 0.0 else -offset
    return add(p, scale(ng, side))


@kernel
def skipped_distance(ng, direction, offset):
    """How far from a surface a ray is at its start, if it has left it by `offset_origin`, along itself [m]."""
    return offset / max(abs(dot(ng, direction)), _LEAST_COSINE)
