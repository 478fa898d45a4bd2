# SPDX-License-Identifier: GPL-3.0-or-later
"""Where instances are in the world, as boxes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from engine.state import geometry as layout
from engine.state.geometry import GeometryArrays

#: How near two things are that lie in one place, in rounding errors: rays end before a light by two, those of both
#: points.
REACH = 4.0


@dataclass(frozen=True)
class WorldBoxes:
    """World-space boxes of all instances, float64 (I, 3), and the largest coordinate on the way there, float64 (I,)."""

    low: np.ndarray
    high: np.ndarray
    extent: np.ndarray


def _mesh_boxes(geometry: GeometryArrays) -> tuple[np.ndarray, np.ndarray]:
    """Middles and half sizes of meshes, float64 (M, 3), of their first shapes."""
    middle = np.zeros((len(geometry.mesh_table), 3))
    half = np.zeros_like(middle)
    rows = np.flatnonzero(geometry.mesh_table[:, layout.MESH_VERTEX_COUNT] > 0)
    if len(rows):
        first, count = geometry.mesh_table[rows][:, [layout.MESH_FIRST_VERTEX, layout.MESH_VERTEX_COUNT]].T
        # Behind each mesh's vertices may be others, of its further steps or of no mesh.
        ends = np.stack([first, first + count], axis=1).ravel().astype(np.int64)
        ends = ends[:-1] if ends[-1] == len(geometry.vertices) else ends
        low = np.minimum.reduceat(geometry.vertices, ends)[::2].astype(np.float64)
        high = np.maximum.reduceat(geometry.vertices, ends)[::2].astype(np.float64)
        middle[rows], half[rows] = 0.5 * (low + high), 0.5 * (high - low)
    return middle, half


def is_baked(geometry: GeometryArrays) -> npt.NDArray[np.bool_]:
    """Which instances have their vertices stored in the world: bool (I,)."""
    return (geometry.instance_table[:, layout.INSTANCE_FLAGS] & layout.INSTANCE_FLAG_BAKED) != 0


def has_triangles(geometry: GeometryArrays) -> npt.NDArray[np.bool_]:
    """Which instances there is anything of: bool (I,)."""
    meshes = geometry.instance_table[:, layout.INSTANCE_MESH]
    has: npt.NDArray[np.bool_] = geometry.mesh_table[meshes, layout.MESH_TRIANGLE_COUNT] > 0
    return has


def are_round(geometry: GeometryArrays) -> npt.NDArray[np.bool_]:
    """Which instances are curves or spheres: bool (I,)."""
    meshes = geometry.instance_table[:, layout.INSTANCE_MESH]
    found: npt.NDArray[np.bool_] = geometry.mesh_table[meshes, layout.MESH_SHAPE] != layout.SHAPE_TRIANGLES
    return found


def world_matrices(geometry: GeometryArrays) -> np.ndarray:
    """From stored vertices to the world, float64 (I, 3, 4), at the middle of the shutter."""
    matrices = geometry.transforms.astype(np.float64).reshape(-1, 3, 4)
    return np.where(is_baked(geometry)[:, None, None], np.eye(3, 4), matrices)


def world_boxes(geometry: GeometryArrays, matrices: np.ndarray) -> WorldBoxes:
    """Boxes around instances by their `world_matrices`; of what is nowhere they are NaN or infinite."""
    middle, half = (found[geometry.instance_table[:, layout.INSTANCE_MESH]] for found in _mesh_boxes(geometry))
    linear = np.abs(matrices[:, :, :3])
    half_size = (linear @ half[:, :, None])[:, :, 0]
    at = (matrices[:, :, :3] @ middle[:, :, None])[:, :, 0] + matrices[:, :, 3]
    within = (linear @ (np.abs(middle) + half)[:, :, None])[:, :, 0]
    return WorldBoxes(at - half_size, at + half_size, np.maximum(np.abs(at) + half_size, within).max(axis=1))
