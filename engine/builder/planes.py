# SPDX-License-Identifier: GPL-3.0-or-later
"""Planes of triangles, and what lies in one of them."""

from __future__ import annotations

import numpy as np

#: Planes of a surface that are looked at: what has more is curved.
MOST_PLANES = 64


def planes_of(vertices: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Planes of triangles, each once: unit normal and distance from the origin, float64 (P, 4).

    Parameters
    ----------
    vertices : float64 (V, 3)
    triangles : int (T, 3)
    """
    v0, v1, v2 = (vertices[triangles[:, k]] for k in range(3))
    normal = np.cross(v1 - v0, v2 - v0)
    length = np.linalg.norm(normal, axis=1)
    normal, v0 = normal[length > 0.0] / length[length > 0.0, None], v0[length > 0.0]
    planes = np.concatenate([normal, (normal * v0).sum(axis=1, keepdims=True)], axis=1)
    _, first = np.unique(planes.round(5), axis=0, return_index=True)
    return planes[first]


def lies_in(planes: np.ndarray, vertices: np.ndarray, triangles: np.ndarray, tolerance: float) -> bool:
    """Whether some triangle lies in one of the planes, that near."""
    for plane in planes:
        is_on = np.abs(vertices @ plane[:3] - plane[3]) <= tolerance
        if is_on.sum() >= 3 and is_on[triangles].all(axis=1).any():
            return True
    return False
