# SPDX-License-Identifier: GPL-3.0-or-later
"""Tangent space of triangles and a UV map, as Mikkelsen's mikktspace (2008), which Cycles uses, defines it."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from engine.array_types import Float32Array
from engine.scene.description import Attribute, Mesh


def compute_tangents(mesh: Mesh, uv: Float32Array, is_flat: npt.NDArray[np.bool_] | None = None) -> Attribute:
    """Tangent and sign of the bitangent at every corner.

    Parameters
    ----------
    uv : float32 (3 * T, 2)
    is_flat : bool (T,), optional
        Triangles of flat faces: Cycles takes their own normals here, whatever those of their corners are.

    Returns
    -------
    Attribute
        'CORNER', width 4: unit tangent in object space; bitangent = w * cross(normal, tangent).

    Notes
    -----
    Corners of equal position, normal and UV share one tangent if their triangles have UVs of the same handedness:
    the mean of the triangles' tangents in the plane of the normal, weighted by the angle at the corner. Unlike
    mikktspace, triangles that touch in such a corner need not be connected by edges.
    """
    triangle_count = len(mesh.triangles)
    points = mesh.vertices[mesh.triangles].astype(np.float64)
    maps = uv.reshape(triangle_count, 3, 2).astype(np.float64)
    edge1, edge2 = points[:, 1] - points[:, 0], points[:, 2] - points[:, 0]
    normals = np.repeat(_normalized(np.cross(edge1, edge2))[:, None], 3, axis=1)
    if mesh.corner_normals is not None and is_flat is not None:
        normals[~is_flat] = mesh.corner_normals[~is_flat]
    elif mesh.corner_normals is not None:
        normals = mesh.corner_normals.astype(np.float64)

    # Mikkelsen 2008, Eq. (3.1): the direction in which u grows.
    t1, t2 = maps[:, 1] - maps[:, 0], maps[:, 2] - maps[:, 0]
    signed_area = t1[:, 0] * t2[:, 1] - t1[:, 1] * t2[:, 0]
    sign = np.where(signed_area > 0.0, 1.0, -1.0)
    tangent = (t2[:, 1, None] * edge1 - t1[:, 1, None] * edge2) * sign[:, None]
    tangent[signed_area == 0.0] = 0.0
    is_valid = (signed_area != 0.0) & (np.linalg.norm(np.cross(edge1, edge2), axis=1) > 0.0)

    # Projected to the plane of each corner's normal, weighted by the angle between the projected edges.
    projected = _normalized(_project(np.repeat(tangent[:, None], 3, axis=1), normals))
    following = _normalized(_project(np.roll(points, -1, axis=1) - points, normals))
    preceding = _normalized(_project(np.roll(points, 1, axis=1) - points, normals))
    angle = np.arccos(np.clip(np.einsum("tij,tij->ti", following, preceding), -1.0, 1.0))
    weighted = (projected * (angle * is_valid[:, None])[..., None]).reshape(-1, 3)

    corner_sign = np.repeat(sign, 3)
    group = _group_corners(mesh, uv, corner_sign, None if mesh.corner_normals is None else normals)
    group_count = int(group.max()) + 1
    total = np.stack([np.bincount(group, weights=weighted[:, i], minlength=group_count) for i in range(3)], axis=1)
    result = np.empty((3 * triangle_count, 4), np.float32)
    result[:, :3] = _normalized(total)[group]
    result[:, 3] = corner_sign
    return Attribute("CORNER", result)


def _group_corners(mesh: Mesh, uv: Float32Array, sign: np.ndarray, normals: np.ndarray | None) -> np.ndarray:
    """Number of the group of corners that share a tangent, (3 * T,); without `normals` each triangle has its own."""
    columns = [mesh.vertices[mesh.triangles.reshape(-1)], uv, sign[:, None].astype(np.float32)]
    if normals is not None:
        columns.append(normals.reshape(-1, 3).astype(np.float32))
    else:
        columns.append(np.repeat(np.arange(len(mesh.triangles), dtype=np.float32), 3)[:, None])
    # Adding zero makes -0 and 0 the same bits.
    rows = np.ascontiguousarray(np.concatenate(columns, axis=1) + np.float32(0.0))
    # Equal rows are told by two products with odd 64-bit numbers (a collision is as likely as a bit flip).
    words = rows.view(np.uint32).astype(np.uint64)
    generator = np.random.default_rng(0)
    hashes = (words * (generator.integers(0, 1 << 63, words.shape[1], np.uint64) * 2 + 1)).sum(axis=1, dtype=np.uint64)
    hashes ^= hashes >> np.uint64(29)
    return np.unique(hashes, return_inverse=True)[1].reshape(-1)


def _project(vectors: np.ndarray, normals: np.ndarray) -> np.ndarray:
    return vectors - normals * np.einsum("tij,tij->ti", vectors, normals)[..., None]


def _normalized(vectors: np.ndarray) -> np.ndarray:
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return np.divide(vectors, length, out=np.zeros_like(vectors), where=length > 0.0)
