# SPDX-License-Identifier: GPL-3.0-or-later
"""Points on curves and spheres: what `engine.kernels.surface` is for triangles.

References
----------
Catmull and Rom 1974, "A class of local interpolating splines" (Computer Aided Geometric Design).
"""

import math

import numpy as np

from engine.kernels.motion import (
    direction_to_object,
    direction_to_world,
    normal_to_world,
    point_to_object,
    point_to_world,
    radius_between,
    vertex_at,
)
from engine.kernels.vector import add, cross, dot, normalize, scale, subtract
from engine.runtime.jit import kernel
from engine.state.geometry import (
    INSTANCE_FLAG_BAKED,
    INSTANCE_FLAGS,
    INSTANCE_MESH,
    MESH_FIRST_RADIUS,
    MESH_FIRST_TRIANGLE,
    MESH_FIRST_VERTEX,
    MESH_SHAPE,
    MESH_TRIANGLE_COUNT,
    SHAPE_RIBBONS,
    SHAPE_ROUND_LINEAR,
    SHAPE_SPHERES,
    SHAPE_TRIANGLES,
)
from engine.state.lanes import (
    POINT_FLAG_IN_PLACE,
    POINT_FLAG_STRAND,
    POINT_FLAGS,
    POINT_INSTANCE,
    POINT_NG,
    POINT_NS,
    POINT_P,
    POINT_TANGENT,
    POINT_TRIANGLE,
    POINT_V,
)

#: A radius whose transform, along the diagonal, is as long as itself where nothing is scaled: 1 / sqrt(3).
_DIAGONAL = np.float32(1.0 / math.sqrt(3.0))


@kernel
def _ends_of(geometry, segment):
    """The vertices of a segment, rows of `vertices`."""
    return np.int64(geometry.triangles[segment, 0]), np.int64(geometry.triangles[segment, 1])


@kernel
def _curve_at(geometry, mesh, segment, u, time):
    """Where a curve is, and its derivative by u, in the space that it is stored in."""
    a, b = _ends_of(geometry, segment)
    p1, p2 = vertex_at(geometry, mesh, a, time), vertex_at(geometry, mesh, b, time)
    along = subtract(p2, p1)
    if geometry.mesh_table[mesh, MESH_SHAPE] == SHAPE_ROUND_LINEAR:
        return add(p1, scale(along, u)), along
    first = geometry.mesh_table[mesh, MESH_FIRST_TRIANGLE]
    last = first + geometry.mesh_table[mesh, MESH_TRIANGLE_COUNT] - 1
    root = geometry.triangles[segment, 2]
    p0, p3 = p1, p2
    if segment > first and geometry.triangles[segment - 1, 2] == root and geometry.triangles[segment - 1, 1] == a:
        p0 = vertex_at(geometry, mesh, np.int64(geometry.triangles[segment - 1, 0]), time)
    if segment < last and geometry.triangles[segment + 1, 2] == root and geometry.triangles[segment + 1, 0] == b:
        p3 = vertex_at(geometry, mesh, np.int64(geometry.triangles[segment + 1, 1]), time)
    before, after = scale(subtract(p2, p0), 0.5), scale(subtract(p3, p1), 0.5)
    # Hermite's form, of which the tangents are these.
    square = subtract(scale(along, 3.0), add(scale(before, 2.0), after))
    cube = subtract(add(before, after), scale(along, 2.0))
    p = add(p1, scale(add(before, scale(add(square, scale(cube, u)), u)), u))
    return p, add(before, scale(add(scale(square, 2.0), scale(cube, 3.0 * u)), u))


@kernel
def _ribbon_normal(tangent, direction, sine):
    """The normal that a round curve would have where a ray meets it, `sine` off its middle."""
    tangent = normalize(tangent)
    across = normalize(cross(direction, tangent))
    cosine = math.sqrt(max(1.0 - sine * sine, 0.0))
    return normalize(subtract(scale(across, sine), scale(normalize(cross(tangent, across)), cosine)))


@kernel
def shape_at(geometry, instance):
    """SHAPE_* of what an instance shows; of none, that of triangles."""
    if instance < 0:
        return SHAPE_TRIANGLES
    return geometry.mesh_table[geometry.instance_table[instance, INSTANCE_MESH], MESH_SHAPE]


@kernel
def centre_of(geometry, instance, row, time):
    """Where the centre of a sphere is in the world."""
    mesh = geometry.instance_table[instance, INSTANCE_MESH]
    centre = vertex_at(geometry, mesh, np.int64(geometry.triangles[row, 0]), time)
    if geometry.instance_table[instance, INSTANCE_FLAGS] & INSTANCE_FLAG_BAKED:
        return centre
    return point_to_world(geometry, instance, time, centre)


@kernel
def prepare_round(geometry, points, lane, u, v, origin, direction, distance, time):
    """Fill the geometric part of a point on a curve or sphere, of which `prepare_point` knows nothing."""
    instance, row = points.integer[lane, POINT_INSTANCE], points.integer[lane, POINT_TRIANGLE]
    mesh = geometry.instance_table[instance, INSTANCE_MESH]
    shape = geometry.mesh_table[mesh, MESH_SHAPE]
    p = add(origin, scale(direction, distance))
    stored, along = p, direction
    is_baked = geometry.instance_table[instance, INSTANCE_FLAGS] & INSTANCE_FLAG_BAKED != 0
    if not is_baked:
        stored = point_to_object(geometry, instance, time, p)
        along = normalize(direction_to_object(geometry, instance, time, direction))
    tangent = scale(direction, 0.0)
    if shape == SHAPE_SPHERES:
        ns = normalize(subtract(p, centre_of(geometry, instance, row, time)))
    else:
        middle, tangent = _curve_at(geometry, mesh, row, u, time)
        if shape == SHAPE_RIBBONS:
            ns = _ribbon_normal(tangent, along, v)
        else:
            ns = normalize(subtract(stored, middle))
        if not is_baked:
            ns = normalize(normal_to_world(geometry, instance, time, ns))
            tangent = direction_to_world(geometry, instance, time, tangent)
    if not dot(ns, ns) > 0.5:
        ns = scale(direction, -1.0)
    real = points.real
    for k in range(3):
        real[lane, POINT_P + k] = p[k]
        # That of a ribbon would be the ray's, which darkens it: as in Cycles, samples are checked against this one.
        real[lane, POINT_NG + k] = ns[k]
        real[lane, POINT_NS + k] = ns[k]
        real[lane, POINT_TANGENT + k] = tangent[k]
    # Attributes are weighed by u alone; how far across a ribbon a point is, the shading normal tells.
    real[lane, POINT_V] = 0.0
    is_strand = shape != SHAPE_SPHERES
    points.integer[lane, POINT_FLAGS] = POINT_FLAG_IN_PLACE | (POINT_FLAG_STRAND if is_strand else 0)


@kernel
def radius_at(geometry, instance, row, u, time):
    """Radius of a curve or sphere [m], in the world; 0 of triangles.

    That of a sphere is the one at the middle of the shutter, as in Cycles.
    """
    mesh = geometry.instance_table[instance, INSTANCE_MESH]
    first = np.int64(geometry.mesh_table[mesh, MESH_FIRST_RADIUS])
    if first < 0:
        return 0.0 * u
    a, b = _ends_of(geometry, row)
    first -= geometry.mesh_table[mesh, MESH_FIRST_VERTEX]
    radius = geometry.radii[first + a]
    if geometry.mesh_table[mesh, MESH_SHAPE] != SHAPE_SPHERES:
        start = radius_between(geometry, mesh, first + a, time)
        radius = (1.0 - u) * start + u * radius_between(geometry, mesh, first + b, time)
    if geometry.instance_table[instance, INSTANCE_FLAGS] & INSTANCE_FLAG_BAKED:
        return radius
    each = radius * _DIAGONAL
    d = direction_to_world(geometry, instance, time, (each, each, each))
    return math.sqrt(dot(d, d))
