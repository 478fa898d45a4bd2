# SPDX-License-Identifier: GPL-3.0-or-later
"""How far around the camera no medium begins or ends: paths that start within are all in the same media."""

from __future__ import annotations

import numpy as np

from engine.scene.description import VISIBLE_CAMERA
from engine.state.geometry import (
    INSTANCE_FLAG_BAKED,
    INSTANCE_FLAG_MOVING,
    INSTANCE_FLAGS,
    INSTANCE_MESH,
    INSTANCE_VISIBILITY,
    MESH_FIRST_TRIANGLE,
    MESH_FIRST_VERTEX,
    MESH_MOTION,
    MESH_TRIANGLE_COUNT,
    MESH_VERTEX_COUNT,
    GeometryArrays,
)

#: Triangles that are looked at where the camera is in the box around a boundary; of more nothing is known.
_MOST_TRIANGLES = 100_000
#: What rounding leaves of a distance, and what it takes away from it, relative to the largest coordinate.
_SHARE, _ROUNDING = 0.99, 1e-5


def _from_box(point: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Distance of a point from boxes, 0 within."""
    distance: np.ndarray = np.linalg.norm(np.maximum(np.maximum(low - point, point - high), 0.0), axis=-1)
    return distance


def _from_triangles(point: np.ndarray, corners: np.ndarray) -> float:
    """No more than the distance of a point from triangles, float64 (T, 3, 3): that of their boxes and planes."""
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    length = np.linalg.norm(normal, axis=1)
    height = np.abs(((point - corners[:, 0]) * normal).sum(axis=1))
    from_plane = np.divide(height, length, out=np.zeros_like(height), where=length > 0.0)
    from_box = _from_box(point, corners.min(axis=1), corners.max(axis=1))
    return float(np.maximum(from_plane, from_box).min())


def clear_distance(point: np.ndarray, geometry: GeometryArrays, has_inside: np.ndarray) -> float:
    """No more than the distance from a point to the next boundary of a medium that cameras see [m]; 0: not known.

    Parameters
    ----------
    point : float (3,), world
    has_inside : bool (N,)
        Whether there is a medium inside of an instance.
    """
    point = np.asarray(point, np.float64)
    table = geometry.instance_table
    nearest, triangle_count = np.inf, 0
    for instance in np.flatnonzero(has_inside & (table[:, INSTANCE_VISIBILITY] & VISIBLE_CAMERA != 0)).tolist():
        mesh = geometry.mesh_table[table[instance, INSTANCE_MESH]]
        flags = table[instance, INSTANCE_FLAGS]
        first, count = int(mesh[MESH_FIRST_VERTEX]), int(mesh[MESH_VERTEX_COUNT])
        if flags & INSTANCE_FLAG_MOVING or mesh[MESH_MOTION] >= 0:
            return 0.0
        if not count or not mesh[MESH_TRIANGLE_COUNT]:
            continue
        vertices = geometry.vertices[first : first + count, :3].astype(np.float64)
        if not flags & INSTANCE_FLAG_BAKED:
            matrix = geometry.transforms[instance].reshape(3, 4).astype(np.float64)
            vertices = vertices @ matrix[:, :3].T + matrix[:, 3]
        distance = float(_from_box(point, vertices.min(axis=0), vertices.max(axis=0)))
        if not distance > 0.0:
            triangle_count += int(mesh[MESH_TRIANGLE_COUNT])
            if triangle_count > _MOST_TRIANGLES:
                return 0.0
            start = int(mesh[MESH_FIRST_TRIANGLE])
            triangles = geometry.triangles[start : start + int(mesh[MESH_TRIANGLE_COUNT]), :3].astype(np.int64)
            distance = _from_triangles(point, vertices[triangles - first])
        distance = _SHARE * distance - _ROUNDING * float(np.abs(vertices).max() + np.abs(point).max())
        if not distance > 0.0:
            return 0.0
        nearest = min(nearest, distance)
    return min(nearest, 1e15)
