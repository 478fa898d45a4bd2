# SPDX-License-Identifier: GPL-3.0-or-later
"""Plane faces of glass that lie in another surface, drawn a little into the glass.

A ray that crosses a surface goes on beyond the error of the point where it met it. Of a glass that stands on a table to
the last bit it would miss the table or the glass, whichever comes second. Between faces that have been drawn apart
there is air, as there is under a glass that stands a tenth of a millimetre higher.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
import numpy.typing as npt

from engine.builder.boundaries import (
    APART,
    BOX_CORNERS,
    MOST_VERTICES,
    TOUCHING,
    box_around,
    instance_boxes,
    world_vertices,
)
from engine.scene.description import Instances, Mesh, SceneDescription

#: Plane faces of a mesh that are looked at, the largest ones.
_MOST_FACES = 64
#: By how much normals, and distances relative to the mesh's size, may differ within one plane face.
_SAME_PLANE = 1e-5
#: Up to where a mesh counts as closed: the sum of its faces' vectors over that of their areas.
_LEAST_OPEN = 1e-3
#: How far a face is drawn at most, relative to the mesh's thickness there.
_MOST_DRAWN = 0.01
#: Pairs of instances of which boxes are compared, and pairs of triangles of which it is worked out whether they
#: overlap: of more it is taken for granted.
_MOST_INSTANCES, _MOST_PAIRS = 100_000_000, 4_000_000
#: Triangles that are looked at together, and cells along each axis by which they are sorted.
_CHUNK, _CELLS = 512, 31


@dataclass(frozen=True)
class _Faces:
    """The largest plane faces of a mesh, in object space.

    normals : float64 (P, 3), out of the glass, unit
    offsets : float64 (P,), of the planes from the origin
    corners : float64 (P, 8, 3), of the boxes around the faces
    members : triangles of each face
    """

    normals: np.ndarray
    offsets: np.ndarray
    corners: np.ndarray
    members: list[np.ndarray]


@dataclass(frozen=True)
class _Placed:
    """Faces in world space: normals (P, 3), offsets (P,), and boxes (P, 3)."""

    normals: np.ndarray
    offsets: np.ndarray
    low: np.ndarray
    high: np.ndarray


def _is_sound(mesh: Mesh) -> bool:
    """Whether all triangles are of vertices that exist; of others there is a notice later."""
    return len(mesh.triangles) > 0 and int(mesh.triangles.max()) < len(mesh.vertices)


def _boxes(triangles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Low and high corners, (N, 3) each, of the boxes around triangles (N, 3, 3)."""
    first, second, third = triangles[:, 0], triangles[:, 1], triangles[:, 2]
    return np.minimum(np.minimum(first, second), third), np.maximum(np.maximum(first, second), third)


def _meet(low: np.ndarray, high: np.ndarray, of_low: np.ndarray, of_high: np.ndarray) -> np.ndarray:
    """Which of the boxes (N, 3) meet a box: bool (N,)."""
    meets = (low[:, 0] <= of_high[0]) & (high[:, 0] >= of_low[0])
    for axis in (1, 2):
        meets &= (low[:, axis] <= of_high[axis]) & (high[:, axis] >= of_low[axis])
    return meets


def _sorted_groups(keys: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Equal keys as groups, in ascending order: the group of each row, and the rows, which ascend within a group."""
    order = np.argsort(keys)
    keys = keys[order]
    group = np.concatenate([[0], np.cumsum(keys[1:] != keys[:-1])])
    # Sorting numbers once more is a tenth of the time of a stable sort of rows.
    rows = np.sort(group * len(keys) + order) - group * len(keys)
    return group, rows


def _largest(values: np.ndarray) -> list[int]:
    """Indices of the `_MOST_FACES` largest values, in descending order, and ascending where values are equal."""
    rows = np.arange(len(values))
    if len(values) > _MOST_FACES:
        rows = np.flatnonzero(values >= np.partition(values, -_MOST_FACES)[-_MOST_FACES])
    return rows[np.argsort(-values[rows], kind="stable")][:_MOST_FACES].tolist()


def _plane_faces(mesh: Mesh) -> _Faces | None:
    """A mesh's largest plane faces, None where it has none.

    Glass is behind the faces' normals, as it is for the material; within what is closed, whichever way these look.
    """
    vertices = mesh.vertices.astype(np.float64)
    if not _is_sound(mesh) or not np.isfinite(vertices).all():
        return None
    corners = vertices[mesh.triangles]
    vectors = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    areas = np.linalg.norm(vectors, axis=1)
    total = areas.sum()
    if not np.isfinite(total) or not total > 0.0:
        return None
    low, high = box_around(vertices)
    middle = 0.5 * (low + high)
    size = float(np.abs(vertices - middle).max())
    is_closed = np.linalg.norm(vectors.sum(axis=0)) <= _LEAST_OPEN * total
    if is_closed and (vectors * (corners[:, 0] - middle)).sum() < 0.0:
        vectors = -vectors
    usable = np.flatnonzero(areas > 0.0)
    normals = vectors[usable] / areas[usable, None]
    heights = (normals * (corners[usable, 0] - middle)).sum(axis=1)
    cells = np.rint(np.concatenate([normals, heights[:, None] / size], axis=1) / _SAME_PLANE).astype(np.int64)
    group, order = _sorted_groups(cells @ np.array([1, 1 << 21, 1 << 42, 0x9E3779B97F4A7C1], np.int64))
    by_group = np.bincount(group, areas[usable[order]])
    ends = np.cumsum(np.bincount(group))
    members = [usable[order[ends[number - 1] if number else 0 : ends[number]]] for number in _largest(by_group)]
    # All faces at once, one after the other.
    rows, starts = np.concatenate(members), np.cumsum([0, *(len(face) for face in members[:-1])])
    own, weights = corners[rows], areas[rows]
    mean = np.add.reduceat(vectors[rows], starts)
    mean /= np.linalg.norm(mean, axis=1, keepdims=True)
    middles = (own.mean(axis=1) * np.repeat(mean, [len(face) for face in members], axis=0)).sum(axis=1)
    low, high = _boxes(own)
    low, high = np.minimum.reduceat(low, starts), np.maximum.reduceat(high, starts)
    return _Faces(
        normals=mean,
        offsets=np.add.reduceat(middles * weights, starts) / np.add.reduceat(weights, starts),
        corners=np.stack([low, high], axis=1)[:, BOX_CORNERS, np.arange(3)],
        members=members,
    )


def _place(faces: _Faces, transform: np.ndarray) -> _Placed | None:
    """Faces in the world; None under a transform without an inverse."""
    matrix = transform.astype(np.float64)
    if not np.isfinite(matrix).all() or np.linalg.det(matrix[:3, :3]) == 0.0:
        return None
    normals = faces.normals @ np.linalg.inv(matrix[:3, :3])
    lengths = np.linalg.norm(normals, axis=1)
    normals /= lengths[:, None]
    corners = faces.corners @ matrix[:3, :3].T + matrix[:3, 3]
    return _Placed(
        normals, faces.offsets / lengths + normals @ matrix[:3, 3], corners.min(axis=1), corners.max(axis=1)
    )


def _overlap(first: np.ndarray, second: np.ndarray, normal: np.ndarray, tolerance: float) -> bool:
    """Whether two sets of triangles in a plane, float64 (M, 3, 3) and (K, 3, 3), overlap by more than an edge."""
    if len(first) * len(second) > _MOST_PAIRS:
        return True
    low, high = _boxes(first)
    for triangle, of_low, of_high in zip(second, *_boxes(second), strict=True):
        near = first[_meet(low, high, of_low, of_high)]
        if not len(near):
            continue
        edges = np.broadcast_to(np.roll(triangle, -1, axis=0) - triangle, near.shape)
        axes = np.cross(np.concatenate([np.roll(near, -1, axis=1) - near, edges], axis=1), normal)
        axes /= np.maximum(np.linalg.norm(axes, axis=2, keepdims=True), 1e-300)
        ours, theirs = np.einsum("nad,nkd->nak", axes, near), axes @ triangle.T
        depth = np.minimum(ours.max(axis=2), theirs.max(axis=2)) - np.maximum(ours.min(axis=2), theirs.min(axis=2))
        if (depth > tolerance).all(axis=1).any():
            return True
    return False


@dataclass(frozen=True)
class _Triangles:
    """Triangles in the order of where they are, in chunks.

    corners : float64 (K, 3, 3); low, high : float64 (K, 3), of their boxes
    chunk_low, chunk_high : float64 (C, 3)
    """

    corners: np.ndarray
    low: np.ndarray
    high: np.ndarray
    chunk_low: np.ndarray
    chunk_high: np.ndarray

    @property
    def extent(self) -> float:
        """The largest coordinate."""
        return float(np.abs([self.chunk_low, self.chunk_high]).max(initial=0.0))

    def near(self, low: np.ndarray, high: np.ndarray) -> np.ndarray:
        """Triangles, float64 (M, 3, 3), whose boxes meet a box."""
        chunks = np.flatnonzero(_meet(self.chunk_low, self.chunk_high, low, high))
        rows = (chunks[:, None] * _CHUNK + np.arange(_CHUNK)).ravel()
        rows = rows[rows < len(self.corners)]
        return self.corners[rows[_meet(self.low[rows], self.high[rows], low, high)]]


def _triangles_within(vertices: np.ndarray, triangles: np.ndarray, low: np.ndarray, high: np.ndarray) -> _Triangles:
    """Triangles that may meet a box."""
    # A bit for each side of the box that a vertex is beyond. What is whole beyond one of them is far.
    beyond = np.zeros(len(vertices), np.uint8)
    for axis in range(3):
        beyond |= (vertices[:, axis] < low[axis]).astype(np.uint8) << (2 * axis)
        beyond |= (vertices[:, axis] > high[axis]).astype(np.uint8) << (2 * axis + 1)
    is_far = beyond[triangles[:, 0]] & beyond[triangles[:, 1]] & beyond[triangles[:, 2]]
    kept = triangles[is_far == 0]
    cells = np.clip((vertices[kept[:, 0]] - low) / np.maximum(high - low, 1e-300), 0.0, 1.0) * _CELLS
    # Numbers of 16 bits are sorted by radix.
    cell = (cells.astype(np.int64) @ np.array([1, _CELLS + 1, (_CELLS + 1) ** 2])).astype(np.uint16)
    corners = vertices[kept[np.argsort(cell, kind="stable")]]
    starts = np.arange(0, len(corners), _CHUNK)
    at_low, at_high = _boxes(corners)
    if not len(starts):
        return _Triangles(corners, at_low, at_high, at_low, at_high)
    return _Triangles(
        corners, at_low, at_high, np.minimum.reduceat(at_low, starts), np.maximum.reduceat(at_high, starts)
    )


def _extents(triangles: np.ndarray) -> np.ndarray:
    """The largest coordinate of each triangle."""
    rows = np.abs(triangles.reshape(-1, 9))
    extents = rows[:, 0].copy()
    for column in range(1, 9):
        np.maximum(extents, rows[:, column], out=extents)
    return extents


def _touched(
    faces: _Faces, placed: _Placed, own: Callable[[], np.ndarray], others: np.ndarray, drawn: np.ndarray
) -> Iterator[tuple[int, float]]:
    """Faces that lie in some other triangle, and the largest coordinate there.

    Parameters
    ----------
    own : callable
        Gives the mesh's triangles, float64 (M, 3, 3): few are asked for.
    others : float64 (K, 3, 3), triangles
    drawn : float64 (P,), how far faces are drawn already
    """
    reach = TOUCHING * APART * np.maximum(_extents(others), np.abs([placed.low, placed.high]).max())
    first_corners = others[:, 0]
    near: list[np.ndarray] = []
    for start in range(0, len(others), 1 << 16):
        rows = slice(start, start + (1 << 16))
        heights = first_corners[rows] @ placed.normals.T - placed.offsets
        near.append(np.argwhere(np.abs(heights) <= reach[rows, None]) + [start, 0])
    at, in_face = np.concatenate(near).T
    for face in np.unique(in_face).tolist():
        if drawn[face] > 0.0:
            continue
        normal, found = placed.normals[face], at[in_face == face]
        triangles, slack = others[found], reach[found, None]
        is_on = (np.abs(triangles @ normal - placed.offsets[face]) <= slack).all(axis=1)
        at_low, at_high = _boxes(triangles)
        is_on &= (at_low <= placed.high[face] + slack).all(axis=1)
        is_on &= (at_high >= placed.low[face] - slack).all(axis=1)
        if not is_on.any():
            continue
        triangles = triangles[is_on]
        tolerance = float(slack[is_on].max())
        members = own()[faces.members[face]]
        members = members[(np.abs(members @ normal - placed.offsets[face]) <= tolerance).all(axis=1)]
        if len(members) and _overlap(members, triangles, normal, tolerance):
            yield face, float(max(_extents(members).max(), _extents(triangles).max()))


def _slots_with(
    instances: Instances, meshes: list[Mesh], wanted: npt.NDArray[np.bool_]
) -> tuple[np.ndarray, np.ndarray]:
    """Whether some, and whether all, of an instance's slots have a wanted material: two bool (N,)."""
    # One more for slots without a material, whose index is -1.
    sums = np.concatenate([[0], np.cumsum(np.append(wanted, False)[instances.materials])])
    slots = np.array([int(mesh.material_slots.max(initial=0)) + 1 for mesh in meshes], np.int64)
    first = np.minimum(instances.material_offset.astype(np.int64), len(sums) - 1)
    last = np.minimum(first + slots[instances.mesh], len(sums) - 1)
    found = sums[last] - sums[first]
    return found > 0, found == last - first


def touching_faces(
    description: SceneDescription, refracts: npt.NDArray[np.bool_], is_boundary: npt.NDArray[np.bool_]
) -> dict[int, np.ndarray]:
    """How far the vertices of meshes move into their glass, by mesh, float64 (V, 3) in object space.

    Only plane faces are looked at, and sheets without a thickness stay. What one of a mesh's instances needs all get.

    Parameters
    ----------
    refracts, is_boundary : bool (M,)
        By material, whether its surface refracts, and whether it is the boundary of a medium and nothing else. Those
        are drawn apart by `engine.builder.boundaries`.
    """
    instances, meshes = description.instances, description.meshes
    if not len(instances.mesh):
        return {}
    is_glass, _ = _slots_with(instances, meshes, refracts)
    _, is_left_out = _slots_with(instances, meshes, is_boundary)
    rows = np.flatnonzero(is_glass)
    if not len(rows) or len(rows) * len(instances.mesh) > _MOST_INSTANCES:
        return {}
    faces = {mesh: _plane_faces(meshes[mesh]) for mesh in np.unique(instances.mesh[rows]).tolist()
             if len(meshes[mesh].vertices) <= MOST_VERTICES}  # fmt: skip
    boxes = instance_boxes(instances, meshes)
    drawn = {mesh: np.zeros(len(found.members)) for mesh, found in faces.items() if found is not None}
    reach = APART * boxes.extent
    low, high = boxes.low - reach[:, None], boxes.high + reach[:, None]
    is_left_out |= ~np.isfinite(boxes.extent)
    touching: dict[int, list[int]] = {}
    placed: dict[int, _Placed | None] = {}
    for row in rows.tolist():
        if int(instances.mesh[row]) not in drawn:
            continue
        is_near = _meet(low, high, low[row], high[row]) & ~is_left_out
        is_near[row] = False
        for other in np.flatnonzero(is_near).tolist():
            touching.setdefault(other, []).append(row)
    for other, near in touching.items():
        mesh = meshes[instances.mesh[other]]
        if len(mesh.vertices) > MOST_VERTICES or not _is_sound(mesh):
            continue
        theirs = _triangles_within(
            world_vertices(instances, meshes, other), mesh.triangles, low[near].min(axis=0), high[near].max(axis=0)
        )
        for row in near if len(theirs.corners) else ():
            if row not in placed:
                found = faces[int(instances.mesh[row])]
                placed[row] = None if found is None else _place(found, instances.transform[row])
            _draw(instances, meshes, row, faces, placed[row], theirs, drawn)
    return {mesh: _offsets(meshes[mesh], faces[mesh], distances)
            for mesh, distances in drawn.items() if (distances > 0.0).any()}  # fmt: skip


def _draw(
    instances: Instances, meshes: list[Mesh], row: int, faces: dict[int, _Faces | None], placed: _Placed | None,
    theirs: _Triangles, drawn: dict[int, np.ndarray],
) -> None:
    """Note in `drawn` how far the faces of an instance are to be drawn away from other triangles [m, object space]."""
    mesh = int(instances.mesh[row])
    found = faces[mesh]
    if found is None or placed is None:
        return
    reach = APART * max(theirs.extent, float(np.abs([placed.low, placed.high]).max()))
    others = theirs.near(placed.low.min(axis=0) - reach, placed.high.max(axis=0) + reach)
    if not len(others):
        return
    own = cache(lambda: world_vertices(instances, meshes, row)[meshes[mesh].triangles])
    linear = instances.transform[row, :3, :3].astype(np.float64)
    for face, extent in _touched(found, placed, own, others, drawn[mesh]):
        distance, normal = APART * extent, placed.normals[face]
        if distance <= _MOST_DRAWN * np.ptp(own() @ normal):
            # Along the normal of the object's space, so far that the plane moves by the distance in the world's.
            drawn[mesh][face] = distance * np.linalg.norm(found.normals[face] @ np.linalg.inv(linear))


def _offsets(mesh: Mesh, faces: _Faces | None, distances: np.ndarray) -> np.ndarray:
    """Ways of a mesh's vertices: those in faces that are drawn move against their normals."""
    vertices = mesh.vertices.astype(np.float64)
    offsets = np.zeros_like(vertices)
    if faces is None:
        return offsets
    taken: list[tuple[np.ndarray, float]] = []
    for face in np.flatnonzero(distances > 0.0).tolist():
        normal, height, distance = faces.normals[face], float(faces.offsets[face]), float(distances[face])
        near = TOUCHING * distance
        if any(normal @ other > 1.0 - 1e-6 and abs(height - at) <= near for other, at in taken):
            continue
        taken.append((normal, height))
        offsets[np.abs(vertices @ normal - height) <= near] -= distance * normal
    return offsets


def draw_into_glass(description: SceneDescription, offsets: dict[int, np.ndarray]) -> SceneDescription:
    """The description with meshes changed as `touching_faces` says."""
    if not offsets:
        return description
    meshes = list(description.meshes)
    for number, offset in offsets.items():
        mesh = meshes[number]
        steps = mesh.motion_vertices
        meshes[number] = replace(
            mesh,
            key=("apart", mesh.key),
            vertices=(mesh.vertices + offset).astype(np.float32),
            motion_vertices=None if steps is None else (steps + offset).astype(np.float32),
        )
    return replace(description, meshes=meshes)
