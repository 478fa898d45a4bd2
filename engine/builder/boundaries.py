# SPDX-License-Identifier: GPL-3.0-or-later
"""Boundaries of media that lie in another surface, drawn a little apart from it.

A ray that crosses a surface goes on beyond the error of the point where it met it. Of two surfaces in one place it
would miss the second: it would never leave the first of two boxes of fog side by side, and go through the floor that
one stands on.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from engine.builder.planes import MOST_PLANES, lies_in, planes_of
from engine.scene.description import Instances, Mesh, SceneDescription

#: How far boundaries are drawn apart, relative to the largest coordinate: more than four times the error of a point
#: (`engine.kernels.surface.surface_point`), twice of which a ray may skip.
_APART = 2.0**-17
#: How far apart two planes may be to count as one, in the same unit.
_TOUCHING = 0.5
#: Vertices of a mesh that are looked at, and pairs of boundaries and instances.
_MOST_VERTICES, _MOST_PAIRS = 1_000_000, 100_000_000
#: Corners of a box: whether each is on the low (0) or the high side (1) along each axis.
_BOX_CORNERS = np.array(list(np.ndindex(2, 2, 2)))


@dataclass(frozen=True)
class _Boxes:
    """World-space boxes of all instances, float64 (N, 3), and the largest coordinate of each, float64 (N,)."""

    low: np.ndarray
    high: np.ndarray
    extent: np.ndarray


def _box_around(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Low and high corner of the box around points (N, 3), N > 0. Numpy takes long for short axes."""
    columns = [points[:, axis] for axis in range(3)]
    return np.array([column.min() for column in columns]), np.array([column.max() for column in columns])


def _instance_boxes(instances: Instances, meshes: list[Mesh]) -> _Boxes:
    """Boxes around instances; of one without vertices, or whose transform is not finite, an empty one."""
    corners = np.full((max(len(meshes), 1), 8, 4), np.nan)
    for index, mesh in enumerate(meshes):
        if len(mesh.vertices):
            corners[index, :, :3] = np.array(_box_around(mesh.vertices))[_BOX_CORNERS, np.arange(3)]
            corners[index, :, 3] = 1.0
    matrices = instances.transform[:, :3].astype(np.float64)
    placed = np.einsum("nij,nkj->nki", matrices, corners[instances.mesh])
    low, high = placed.min(axis=1, initial=np.inf), placed.max(axis=1, initial=-np.inf)
    return _Boxes(low, high, np.maximum(np.abs(low), np.abs(high)).max(axis=1, initial=0.0))


def _boundary_rows(instances: Instances, meshes: list[Mesh], is_boundary: npt.NDArray[np.bool_]) -> list[int]:
    """Instances all of whose surface is a boundary of media and nothing else; `is_boundary` is by material."""
    # One more for slots without a material, whose index is -1.
    of_slot = np.append(is_boundary, False)[instances.materials]
    rows: list[int] = []
    for number in np.unique(instances.mesh[of_slot[np.minimum(instances.material_offset, len(of_slot) - 1)]]):
        slots = np.unique(meshes[number].material_slots)
        users = np.flatnonzero(instances.mesh == number)
        places = np.minimum(instances.material_offset[users, None] + slots, len(of_slot) - 1)
        rows += users[of_slot[places].all(axis=1)].tolist()
    return sorted(rows)


def _world_vertices(instances: Instances, meshes: list[Mesh], row: int) -> np.ndarray:
    """Vertices of an instance, float64 (V, 3)."""
    matrix = instances.transform[row].astype(np.float64)
    return meshes[instances.mesh[row]].vertices.astype(np.float64) @ matrix[:3, :3].T + matrix[:3, 3]


def _share_vertices(first: np.ndarray, second: np.ndarray, tolerance: float) -> bool:
    """Whether three vertices of one are vertices of the other."""
    cells = [np.unique(np.rint(vertices / max(tolerance, 1e-300)), axis=0) for vertices in (first, second)]
    both = np.concatenate(cells)
    return len(both) - len(np.unique(both, axis=0)) >= 3


def _touching(
    instances: Instances, meshes: list[Mesh], rows: list[int], placed: _Boxes
) -> Iterator[tuple[int, list[int]]]:
    """Boundaries with what has a face in one of theirs."""
    reach = _APART * placed.extent
    for row in rows:
        mesh = meshes[instances.mesh[row]]
        if not np.isfinite(placed.extent[row]) or len(mesh.vertices) > _MOST_VERTICES:
            continue
        is_near = (placed.low <= placed.high[row] + reach[row]).all(axis=1)
        is_near &= (placed.high >= placed.low[row] - reach[row]).all(axis=1)
        is_near[row] = False
        near = np.flatnonzero(is_near)
        if not len(near):
            continue
        vertices = _world_vertices(instances, meshes, row)
        planes = planes_of(vertices, mesh.triangles)
        found = []
        for other in near.tolist():
            triangles = meshes[instances.mesh[other]].triangles
            tolerance = _TOUCHING * max(reach[row], reach[other])
            others = _world_vertices(instances, meshes, other)
            if len(others) > _MOST_VERTICES:
                continue
            if (lies_in(planes, others, triangles, tolerance) if len(planes) <= MOST_PLANES
                    else _share_vertices(vertices, others, tolerance)):  # fmt: skip
                found.append(other)
        if found:
            yield row, found


def _grown(mesh: Mesh, transform: np.ndarray, distance: float) -> np.ndarray:
    """A transform, float (..., 4, 4), whose box is larger by a distance of the world on all sides."""
    low, high = mesh.vertices.min(axis=0).astype(np.float64), mesh.vertices.max(axis=0).astype(np.float64)
    lengths = np.linalg.norm(np.asarray(transform, np.float64).reshape(-1, 4, 4)[0, :3, :3], axis=0)
    half = 0.5 * (high - low) * lengths
    grow = np.eye(4)
    factor = 1.0 + np.where(half > distance, distance / np.maximum(half, 1e-300), 0.0)
    grow[:3, :3] = np.diag(factor)
    grow[:3, 3] = 0.5 * (low + high) * (1.0 - factor)
    return np.asarray(transform @ grow, np.float32)


def touching_boundaries(description: SceneDescription, is_boundary: npt.NDArray[np.bool_]) -> dict[int, float]:
    """Boundaries of media that lie in another surface, by instance, and how far each is to grow on all sides [m].

    Those that touch each other grow by different multiples of one length.

    Parameters
    ----------
    is_boundary : bool (M,)
        By material, whether it is the boundary of a medium and nothing else.
    """
    instances, meshes = description.instances, description.meshes
    rows = _boundary_rows(instances, meshes, is_boundary) if is_boundary.any() and len(instances.mesh) else []
    if not rows or len(rows) * len(instances.mesh) > _MOST_PAIRS:
        return {}
    placed = _instance_boxes(instances, meshes)
    levels: dict[int, int] = {}
    distances: dict[int, float] = {}
    for row, others in _touching(instances, meshes, rows, placed):
        taken = {levels.get(other, 0) for other in others}
        levels[row] = next(level for level in range(1, len(taken) + 2) if level not in taken)
        distances[row] = levels[row] * _APART * float(placed.extent[[row, *others]].max())
    return distances


def separate_boundaries(description: SceneDescription, distances: dict[int, float]) -> SceneDescription:
    """The description with instances that have grown as `touching_boundaries` says.

    Faces whose plane goes through the middle of their object stay where they are.
    """
    if not distances:
        return description
    instances, meshes = description.instances, description.meshes
    transform, motion = instances.transform.copy(), dict(instances.motion)
    for row, distance in distances.items():
        mesh = meshes[instances.mesh[row]]
        transform[row] = _grown(mesh, instances.transform[row], distance)
        if row in motion:
            motion[row] = _grown(mesh, motion[row], distance)
    return replace(description, instances=replace(instances, transform=transform, motion=motion))
