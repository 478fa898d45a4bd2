# SPDX-License-Identifier: GPL-3.0-or-later
"""Where things are at a path's time: transforms and triangles of what moves while the shutter is open.

Positions lie on straight lines between evenly spaced keys, exactly as Embree intersects them; turns have enough keys
(`engine.builder.motion`). What stands still costs one test of a flag. Time runs from 0, the shutter's opening, to 1.
"""

import numpy as np

from engine.kernels.vector import load, transform_direction, transform_normal, transform_point
from engine.runtime.jit import kernel
from engine.state.geometry import (
    INSTANCE_FIRST_KEY,
    INSTANCE_FLAG_BAKED,
    INSTANCE_FLAG_MOVING,
    INSTANCE_FLAGS,
    INSTANCE_KEY_COUNT,
    INSTANCE_MESH,
    MESH_FIRST_TRIANGLE,
    MESH_FIRST_VERTEX,
    MESH_MOTION,
    MESH_TRIANGLE_COUNT,
    MESH_VERTEX_COUNT,
    MOTION_FIRST_NORMAL,
    MOTION_FIRST_VERTEX,
    MOTION_STEP_COUNT,
)


@kernel
def key_at(count, time):
    """Last of `count` evenly spaced keys, two or more, not after `time`, and how far the next one is reached."""
    at = time * np.float32(count - 1)
    key = max(min(int(at), count - 2), 0)
    return key, at - np.float32(key)


@kernel
def matrix_between(keys, first, count, time):
    """Affine matrix, a tuple of 12 (3x4, row-major), at a time: of rows first to first + count of float32 (K, 12)."""
    key, fraction = key_at(count, time)
    a = first + key
    b = a + 1
    rest = 1.0 - fraction
    return (
        rest * keys[a, 0] + fraction * keys[b, 0],
        rest * keys[a, 1] + fraction * keys[b, 1],
        rest * keys[a, 2] + fraction * keys[b, 2],
        rest * keys[a, 3] + fraction * keys[b, 3],
        rest * keys[a, 4] + fraction * keys[b, 4],
        rest * keys[a, 5] + fraction * keys[b, 5],
        rest * keys[a, 6] + fraction * keys[b, 6],
        rest * keys[a, 7] + fraction * keys[b, 7],
        rest * keys[a, 8] + fraction * keys[b, 8],
        rest * keys[a, 9] + fraction * keys[b, 9],
        rest * keys[a, 10] + fraction * keys[b, 10],
        rest * keys[a, 11] + fraction * keys[b, 11],
    )


@kernel
def apply_direction(m, d):
    """The linear part of an affine matrix, a tuple of 12, applied to a direction."""
    return (
        m[0] * d[0] + m[1] * d[1] + m[2] * d[2],
        m[4] * d[0] + m[5] * d[1] + m[6] * d[2],
        m[8] * d[0] + m[9] * d[1] + m[10] * d[2],
    )


@kernel
def apply_point(m, p):
    """An affine matrix, a tuple of 12, applied to a point."""
    d = apply_direction(m, p)
    return d[0] + m[3], d[1] + m[7], d[2] + m[11]


@kernel
def _inverse(m):
    """Inverse of the linear part of an affine matrix, a tuple of 9 (row-major); zeros where there is none."""
    c0 = m[5] * m[10] - m[6] * m[9]
    c1 = m[6] * m[8] - m[4] * m[10]
    c2 = m[4] * m[9] - m[5] * m[8]
    determinant = m[0] * c0 + m[1] * c1 + m[2] * c2
    scale = 1.0 / determinant if determinant != 0.0 else 0.0 * determinant
    return (
        scale * c0, scale * (m[2] * m[9] - m[1] * m[10]), scale * (m[1] * m[6] - m[2] * m[5]),
        scale * c1, scale * (m[0] * m[10] - m[2] * m[8]), scale * (m[2] * m[4] - m[0] * m[6]),
        scale * c2, scale * (m[1] * m[8] - m[0] * m[9]), scale * (m[0] * m[5] - m[1] * m[4]),
    )  # fmt: skip


@kernel
def _apply(i, d):
    """A matrix, a tuple of 9 (row-major), applied to a vector."""
    return (
        i[0] * d[0] + i[1] * d[1] + i[2] * d[2],
        i[3] * d[0] + i[4] * d[1] + i[5] * d[2],
        i[6] * d[0] + i[7] * d[1] + i[8] * d[2],
    )


@kernel
def _apply_transposed(i, n):
    """The transpose of a matrix, a tuple of 9 (row-major), applied to a vector."""
    return (
        i[0] * n[0] + i[3] * n[1] + i[6] * n[2],
        i[1] * n[0] + i[4] * n[1] + i[7] * n[2],
        i[2] * n[0] + i[5] * n[1] + i[8] * n[2],
    )


@kernel
def _moving_matrix(geometry, instance, time):
    """Object to world of an instance that moves, a tuple of 12."""
    first = geometry.instance_table[instance, INSTANCE_FIRST_KEY]
    count = geometry.instance_table[instance, INSTANCE_KEY_COUNT]
    return matrix_between(geometry.motion_transforms, first, count, time)


@kernel
def is_moving(geometry, instance):
    """Whether an instance's transform depends on time."""
    return (geometry.instance_table[instance, INSTANCE_FLAGS] & INSTANCE_FLAG_MOVING) != 0


@kernel
def point_to_world(geometry, instance, time, p):
    """Object to world space."""
    if is_moving(geometry, instance):
        return apply_point(_moving_matrix(geometry, instance, time), p)
    return transform_point(geometry.transforms, instance, p)


@kernel
def direction_to_world(geometry, instance, time, d):
    """Object to world space, not normalised."""
    if is_moving(geometry, instance):
        return apply_direction(_moving_matrix(geometry, instance, time), d)
    return transform_direction(geometry.transforms, instance, d)


@kernel
def normal_to_world(geometry, instance, time, n):
    """Object to world space, not normalised."""
    if is_moving(geometry, instance):
        return _apply_transposed(_inverse(_moving_matrix(geometry, instance, time)), n)
    return transform_normal(geometry.inverses, instance, n)


@kernel
def point_to_object(geometry, instance, time, p):
    """World to object space."""
    if is_moving(geometry, instance):
        m = _moving_matrix(geometry, instance, time)
        return _apply(_inverse(m), (p[0] - m[3], p[1] - m[7], p[2] - m[11]))
    return transform_point(geometry.inverses, instance, p)


@kernel
def direction_to_object(geometry, instance, time, d):
    """World to object space, not normalised."""
    if is_moving(geometry, instance):
        return _apply(_inverse(_moving_matrix(geometry, instance, time)), d)
    return transform_direction(geometry.inverses, instance, d)


@kernel
def normal_to_object(geometry, instance, time, n):
    """World to object space, not normalised."""
    if is_moving(geometry, instance):
        m = _moving_matrix(geometry, instance, time)
        return (
            m[0] * n[0] + m[4] * n[1] + m[8] * n[2],
            m[1] * n[0] + m[5] * n[1] + m[9] * n[2],
            m[2] * n[0] + m[6] * n[1] + m[10] * n[2],
        )
    return transform_normal(geometry.transforms, instance, n)


@kernel
def move_surface(geometry, instance, time, p, extent, ng, ns):
    """A point of a moving instance's surface, from object to world space.

    Parameters
    ----------
    p, ng, ns : 3-tuples, the point and its normals
    extent : float32, largest coordinate of its triangle

    Returns
    -------
    p, ng, ns : 3-tuples, normals not normalised
    extent : float32, largest coordinate on the way
    """
    m = _moving_matrix(geometry, instance, time)
    i = _inverse(m)
    widest = apply_direction(m, (extent, extent, extent))
    p = apply_point(m, p)
    return (
        p,
        _apply_transposed(i, ng),
        _apply_transposed(i, ns),
        max(abs(widest[0]), abs(widest[1]), abs(widest[2]), abs(p[0]), abs(p[1]), abs(p[2])),
    )


@kernel
def _between(array, a, b, fraction):
    """A point between two rows."""
    u = load(array, a)
    v = load(array, b)
    rest = 1.0 - fraction
    return (
        rest * u[0] + fraction * v[0],
        rest * u[1] + fraction * v[1],
        rest * u[2] + fraction * v[2],
    )


@kernel(forceinline=True)
def _vertex_keys(geometry, mesh, time):
    """What to add to a vertex for its row at the key before `time`, then for the key behind, and the share of that."""
    motion = geometry.mesh_table[mesh, MESH_MOTION]
    key, fraction = key_at(geometry.motion_table[motion, MOTION_STEP_COUNT], time)
    step = np.int64(geometry.mesh_table[mesh, MESH_VERTEX_COUNT])
    offset = np.int64(geometry.motion_table[motion, MOTION_FIRST_VERTEX]) + key * step
    return offset - geometry.mesh_table[mesh, MESH_FIRST_VERTEX], step, fraction


@kernel
def vertex_at(geometry, mesh, vertex, time):
    """A vertex of a mesh, in the space that the mesh is stored in."""
    if geometry.mesh_table[mesh, MESH_MOTION] < 0:
        return load(geometry.vertices, vertex)
    offset, step, fraction = _vertex_keys(geometry, mesh, time)
    return _between(geometry.vertices, vertex + offset, vertex + offset + step, fraction)


@kernel
def radius_between(geometry, mesh, row, time):
    """A radius of a curve or sphere at a time; `row` of `radii` is that at the middle of the shutter."""
    if geometry.mesh_table[mesh, MESH_MOTION] < 0:
        return geometry.radii[row]
    motion = geometry.mesh_table[mesh, MESH_MOTION]
    key, fraction = key_at(geometry.motion_table[motion, MOTION_STEP_COUNT], time)
    step = np.int64(geometry.mesh_table[mesh, MESH_VERTEX_COUNT])
    row += (1 + key) * step
    return (1.0 - fraction) * geometry.radii[row] + fraction * geometry.radii[row + step]


@kernel(forceinline=True)
def triangle_at(geometry, mesh, triangle, time):
    """Vertices of a triangle, in the space that the mesh is stored in."""
    if geometry.mesh_table[mesh, MESH_MOTION] >= 0:
        return _bent_triangle(geometry, mesh, triangle, time)
    a = np.int64(geometry.triangles[triangle, 0])
    b = np.int64(geometry.triangles[triangle, 1])
    c = np.int64(geometry.triangles[triangle, 2])
    return load(geometry.vertices, a), load(geometry.vertices, b), load(geometry.vertices, c)


@kernel
def _bent_triangle(geometry, mesh, triangle, time):
    """Vertices of a triangle of a mesh that changes its shape."""
    a = np.int64(geometry.triangles[triangle, 0])
    b = np.int64(geometry.triangles[triangle, 1])
    c = np.int64(geometry.triangles[triangle, 2])
    offset, step, fraction = _vertex_keys(geometry, mesh, time)
    a += offset
    b += offset
    c += offset
    vertices = geometry.vertices
    return (
        _between(vertices, a, a + step, fraction),
        _between(vertices, b, b + step, fraction),
        _between(vertices, c, c + step, fraction),
    )


@kernel
def moving_triangle(geometry, instance, triangle, time):
    """World space vertices of a triangle that moves or changes its shape."""
    v0, v1, v2 = triangle_at(geometry, geometry.instance_table[instance, INSTANCE_MESH], triangle, time)
    if not geometry.instance_table[instance, INSTANCE_FLAGS] & INSTANCE_FLAG_BAKED:
        v0 = point_to_world(geometry, instance, time, v0)
        v1 = point_to_world(geometry, instance, time, v1)
        v2 = point_to_world(geometry, instance, time, v2)
    return v0, v1, v2


@kernel(forceinline=True)
def normals_at(geometry, mesh, first_normal, triangle, time):
    """Corner normals of a triangle of a smooth mesh, in the space it is stored in; unit where it keeps its shape.

    Parameters
    ----------
    first_normal : int
        Row of the mesh's first triangle, MESH_FIRST_NORMAL.
    """
    if geometry.mesh_table[mesh, MESH_MOTION] >= 0:
        return _bent_normals(geometry, mesh, triangle, time)
    normals = geometry.corner_normals
    row = np.int64(first_normal + triangle - geometry.mesh_table[mesh, MESH_FIRST_TRIANGLE])
    return (
        (normals[row, 0], normals[row, 1], normals[row, 2]),
        (normals[row, 3], normals[row, 4], normals[row, 5]),
        (normals[row, 6], normals[row, 7], normals[row, 8]),
    )


@kernel
def _bent_normals(geometry, mesh, triangle, time):
    """Corner normals of a triangle of a mesh that changes its shape."""
    normals = geometry.corner_normals
    local = triangle - geometry.mesh_table[mesh, MESH_FIRST_TRIANGLE]
    motion = geometry.mesh_table[mesh, MESH_MOTION]
    key, f = key_at(geometry.motion_table[motion, MOTION_STEP_COUNT], time)
    step = np.int64(geometry.mesh_table[mesh, MESH_TRIANGLE_COUNT])
    row = np.int64(geometry.motion_table[motion, MOTION_FIRST_NORMAL]) + key * step + local
    after = row + step
    r = 1.0 - f
    return (
        (
            r * normals[row, 0] + f * normals[after, 0],
            r * normals[row, 1] + f * normals[after, 1],
            r * normals[row, 2] + f * normals[after, 2],
        ),
        (
            r * normals[row, 3] + f * normals[after, 3],
            r * normals[row, 4] + f * normals[after, 4],
            r * normals[row, 5] + f * normals[after, 5],
        ),
        (
            r * normals[row, 6] + f * normals[after, 6],
            r * normals[row, 7] + f * normals[after, 7],
            r * normals[row, 8] + f * normals[after, 8],
        ),
    )
