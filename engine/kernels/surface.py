# SPDX-License-Identifier: GPL-3.0-or-later
"""Points on surfaces: position, normals, rounding error, and the ray's start that clears it.

On what is far from the origin rays start in place (`ray_start`), and skip the triangle that they start on.
"""

import numpy as np

from engine.kernels.motion import (
    direction_to_object,
    move_surface,
    normal_to_world,
    normals_at,
    point_to_object,
    triangle_at,
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
from engine.state.geometry import (
    INSTANCE_FLAG_BAKED,
    INSTANCE_FLAG_IN_PLACE,
    INSTANCE_FLAG_MIRRORED,
    INSTANCE_FLAG_MOVING,
    INSTANCE_FLAGS,
    INSTANCE_MATERIAL_OFFSET,
    INSTANCE_MESH,
    MESH_FIRST_NORMAL,
    MESH_SHAPE,
    SHAPE_TRIANGLES,
)
from engine.state.lanes import (
    POINT_FLAG_BACKFACING,
    POINT_FLAG_IN_PLACE,
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
#: How far a ray starts off a surface where it must: in steps of float32, but near zero, where these are tiny [m].
_STEPS = np.float32(256.0)
_NEAR_ZERO, _STEP_NEAR_ZERO = np.float32(1.0 / 32.0), np.float32(1.0 / 65536.0)
#: Rounding of float32: the share of their sum by which edges' numbers may be on the wrong side for Embree.
_ROUNDING = np.float32(2.0**-23)


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
    # As Cycles does it: exactly in the plane of a triangle that is parallel to two axes, where w * v0 rounds off it.
    p = (
        v0[0] + u * (v1[0] - v0[0]) + v * (v2[0] - v0[0]),
        v0[1] + u * (v1[1] - v0[1]) + v * (v2[1] - v0[1]),
        v0[2] + u * (v1[2] - v0[2]) + v * (v2[2] - v0[2]),
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
def starts_in_place(geometry, instance):
    """Whether rays leave and meet an instance in place, not a rounding error off (`engine.builder.same_place`)."""
    return geometry.instance_table[instance, INSTANCE_FLAGS] & INSTANCE_FLAG_IN_PLACE != 0


@kernel
def prepare_point(geometry, points, lane, instance, triangle, u, v, direction, time):
    """Fill the geometric part of a point to shade; returns its error bound [m]."""
    p, ng, ns, error = surface_point(geometry, instance, triangle, u, v, time)
    flags = 0
    if dot(ng, direction) > 0.0:
        ng = negate(ng)
        ns = negate(ns)
        flags = POINT_FLAG_BACKFACING
    if starts_in_place(geometry, instance):
        flags |= POINT_FLAG_IN_PLACE
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


@kernel
def gap_before(geometry, instance, ng, direction, offset):
    """How far before a surface dense media end [m]: as far as rays skip that leave it, which is nothing in place."""
    if starts_in_place(geometry, instance):
        return 0.0 * offset
    return skipped_distance(ng, direction, offset)


@kernel(fastmath=False)
def _side_of_edge(a, b, direction):
    """On which side of the edge from b to a a line passes, and by how much; a and b are seen from a point on it."""
    sx, sy, sz = a[0] + b[0], a[1] + b[1], a[2] + b[2]
    ex, ey, ez = a[0] - b[0], a[1] - b[1], a[2] - b[2]
    x, y, z = sy * ez - sz * ey, sz * ex - sx * ez, sx * ey - sy * ex
    return x * direction[0] + y * direction[1] + z * direction[2]


@kernel(fastmath=False)
def _is_within(p, direction, v0, v1, v2):
    """Whether a line meets a triangle so far within its edges that it meets none beside it.

    Found as Embree finds it, by Plücker coordinates, in this order: all depends on the last bits.
    """
    a = (v0[0] - p[0], v0[1] - p[1], v0[2] - p[2])
    b = (v1[0] - p[0], v1[1] - p[1], v1[2] - p[2])
    c = (v2[0] - p[0], v2[1] - p[1], v2[2] - p[2])
    u, v, w = _side_of_edge(c, a, direction), _side_of_edge(a, b, direction), _side_of_edge(b, c, direction)
    slack = _ROUNDING * abs(u + v + w)
    return min(u, v, w) >= slack or max(u, v, w) <= -slack


@kernel
def _step_off(x, n):
    """A coordinate moved along the normal's, `n`, by more than it may be wrong; as Cycles does it."""
    if abs(x) < _NEAR_ZERO:
        return x + n * _STEP_NEAR_ZERO
    steps = np.int32(n * _STEPS)
    return np.int32(np.float32(x).view(np.int32) + (-steps if x < 0.0 else steps)).view(np.float32)


@kernel
def behind(distance):
    """How far from where it was met a ray begins that goes on in place through a surface at `distance` [m].

    It is the step to the next float32, as in Cycles: what lies in the same place is not met behind the surface. Two
    surfaces in one place, which skip one surface each, would be met in turn for ever.
    """
    distance = np.float32(distance)
    return np.int32(distance.view(np.int32) + 1).view(np.float32) - distance


@kernel
def ray_start(geometry, instance, triangle, p, direction, time):
    """Where a ray starts in place that leaves a triangle at `p`, which it skips: there, with rare exceptions.

    Where rounding has put `p` beside the triangle, or onto its edge, the ray would meet its neighbour. There it starts
    a little off the surface.

    References
    ----------
    Waechter and Binder 2019, "A Fast and Robust Method for Avoiding Self-Intersection" (Ray Tracing Gems, chapter 6).
    """
    mesh = geometry.instance_table[instance, INSTANCE_MESH]
    if geometry.mesh_table[mesh, MESH_SHAPE] != SHAPE_TRIANGLES:
        # All of the curve is skipped.
        return p
    v0, v1, v2 = triangle_at(geometry, mesh, triangle, time)
    is_baked = geometry.instance_table[instance, INSTANCE_FLAGS] & INSTANCE_FLAG_BAKED != 0
    at, along = p, direction
    if not is_baked:
        at = point_to_object(geometry, instance, time, p)
        along = direction_to_object(geometry, instance, time, direction)
    if _is_within(at, along, v0, v1, v2):
        return p
    ng = cross(subtract(v1, v0), subtract(v2, v0))
    if not is_baked:
        ng = normal_to_world(geometry, instance, time, ng)
    ng = normalize(ng)
    if dot(ng, direction) < 0.0:
        ng = negate(ng)
    return _step_off(p[0], ng[0]), _step_off(p[1], ng[1]), _step_off(p[2], ng[2])
