# SPDX-License-Identifier: GPL-3.0-or-later
"""Normals of displaced meshes, by the rules of Cycles."""

from __future__ import annotations

import numpy as np

from engine.array_types import Float32Array
from engine.scene.attribute_names import SMOOTH, VERTEX_NORMALS
from engine.scene.description import Mesh


def face_normals(vertices: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Unit normals of triangles, float64 (T, 3); along x where a triangle has no area."""
    a, b, c = (vertices[triangles[:, corner]].astype(np.float64) for corner in range(3))
    with np.errstate(invalid="ignore", over="ignore"):
        normals = np.cross(b - a, c - a)
        lengths = np.linalg.norm(normals, axis=1)
    has_none = ~((lengths > 0.0) & np.isfinite(lengths))
    normals[has_none], lengths[has_none] = (1.0, 0.0, 0.0), 1.0
    normals /= lengths[:, None]
    return normals


def unit_vectors(vectors: np.ndarray) -> Float32Array:
    """Vectors along the last axis, of length 1; 0 where they are 0."""
    lengths = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return np.divide(vectors, lengths, out=np.zeros_like(vectors), where=lengths > 0.0).astype(np.float32)


def vertex_normals(vertices: np.ndarray, triangles: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """Unit mean of the normals of the triangles around each vertex, all alike; 0 where there are none."""
    corners = triangles.reshape(-1)
    total = np.stack(
        [np.bincount(corners, np.repeat(normals[:, axis], 3), minlength=len(vertices)) for axis in range(3)], axis=1
    )
    total = total.astype(np.float64)
    lengths = np.linalg.norm(total, axis=1, keepdims=True)
    return np.divide(total, lengths, out=np.zeros_like(total), where=lengths > 0.0)


def displaced_normals(
    mesh: Mesh, before: np.ndarray, after: np.ndarray, corner_normals: np.ndarray | None, bends: np.ndarray
) -> Float32Array | None:
    """Normals of corners after displacement, float32 (T, 3, 3); None where every face is flat.

    Where Cycles has normals of vertices, those around triangles whose normals are to follow are made anew. Where it
    has normals of corners, all of them turn by as much as the vertex' normal does.

    Parameters
    ----------
    before, after : float32 (V, 3)
        Vertices before and after displacement.
    corner_normals : float32 (T, 3, 3) or None
        Those before.
    bends : bool (T,)
        Whose normals follow: those of the others are bent by their material.
    """
    if corner_normals is None:
        return None
    triangles = mesh.triangles
    faces = face_normals(after, triangles)
    if VERTEX_NORMALS in mesh.attributes:
        normals = corner_normals.astype(np.float32)
        around = vertex_normals(after, triangles[bends], faces[bends])
        corners = triangles.reshape(-1)
        is_new = np.zeros(len(after), np.bool_)
        is_new[triangles[bends].reshape(-1)] = True
        at = is_new[corners]
        normals.reshape(-1, 3)[at] = around[corners[at]]
    else:
        turn = vertex_normals(after, triangles, faces)
        turn -= vertex_normals(before, triangles, face_normals(before, triangles))
        normals = unit_vectors(corner_normals + turn[triangles])
    is_smooth = mesh.attributes.get(SMOOTH)
    if is_smooth is not None:
        is_flat = is_smooth.data[:, 0] == 0.0
        normals[is_flat] = faces[is_flat, None]
    return normals
