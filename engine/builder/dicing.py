# SPDX-License-Identifier: GPL-3.0-or-later
"""Divides the triangles of meshes until their edges are as short as wanted, without cracks.

Whether an edge is halved depends on its two ends alone, so that both triangles beside it agree. Triangles are divided
into two, three or four, by how many of their edges are (Bank, Sherman and Weiser 1983, red and green refinement).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from engine.array_types import Float32Array
from engine.builder.displaced_normals import unit_vectors
from engine.scene.attribute_names import VERTEX_NORMALS
from engine.scene.description import Attribute, Mesh
from engine.scene.dicing import Dicing
from engine.scene.limits import check_memory_of

#: Edges are halved that are longer than this many of the lengths they may have. By halves alone edges come out between
#: this and half of it; with it there are as many triangles as Cycles makes, which divides edges into any number.
_TOO_LONG = 1.7
#: Triangles that a square of one length each way becomes.
_TRIANGLES_PER_SQUARE = 2.3
#: No edge need be shorter.
_LEAST = 1e-12
#: Corners of what a triangle becomes: 0 to 2 are its own, 3 to 5 the middles of its edges, the first of which begins at
#: corner 0. By how many edges are halved: the first, the first two with either diagonal, all.
_HALVED_ONE = ((0, 3, 2), (3, 1, 2))
_HALVED_TWO = ((3, 1, 4), (0, 3, 4), (0, 4, 2))
_HALVED_TWO_OTHERWISE = ((3, 1, 4), (0, 3, 2), (3, 4, 2))
_HALVED_ALL = ((0, 3, 5), (3, 1, 4), (5, 4, 2), (3, 4, 5))


@dataclass
class _Part:
    """Triangles: their corners' numbers (N, 3), the triangle of the mesh that each lies in, and where, (N, 3, 2)."""

    corners: np.ndarray
    base: np.ndarray
    places: np.ndarray

    def rows(self, rows: np.ndarray) -> _Part:
        """Some of them."""
        return _Part(self.corners[rows], self.base[rows], self.places[rows])


@dataclass
class _Points:
    """Vertices: positions (N, 3), lengths (N,), and the triangle of the mesh that each lies in, and where, (N, 2)."""

    positions: np.ndarray
    lengths: np.ndarray
    base: np.ndarray
    places: np.ndarray


def dice_meshes(meshes: Sequence[Mesh], check_cancel: Callable[[], None] = lambda: None) -> list[Mesh]:
    """Meshes divided as they ask to be.

    Raises
    ------
    ValueError
        Where there is no memory for that, naming the mesh and how many triangles it would be.
    """
    result = []
    for mesh in meshes:
        if mesh.dicing is not None:
            check_cancel()
            count = estimated_count(mesh, mesh.dicing)
            check_memory_of(count, f"mesh {mesh.name}, diced for its displacement,")
            mesh = diced(mesh, mesh.dicing, check_cancel)
        result.append(mesh)
    return result


def estimated_count(mesh: Mesh, dicing: Dicing) -> int:
    """About how many triangles there will be."""
    positions, lengths = _measured(mesh, dicing)
    a, b, c = (positions[mesh.triangles[:, corner]].astype(np.float64) for corner in range(3))
    with np.errstate(invalid="ignore", over="ignore"):
        areas = 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1)
        counts = _TRIANGLES_PER_SQUARE * areas / np.square(lengths[mesh.triangles].min(axis=1))
    return int(np.clip(np.nan_to_num(counts, posinf=4.0**dicing.level), 1.0, 4.0**dicing.level).sum())


def diced(mesh: Mesh, dicing: Dicing, check_cancel: Callable[[], None] = lambda: None) -> Mesh:
    """A mesh with its triangles divided."""
    if not len(mesh.triangles) or int(mesh.triangles.max()) >= len(mesh.vertices):
        return replace(mesh, dicing=None)
    part, points = _first(mesh, dicing)
    finished = []
    for _ in range(dicing.level):
        check_cancel()
        part, points, rest = _halve(part, points, dicing)
        finished.append(rest)
        if not len(part.base):
            break
    finished.append(part)
    base = np.concatenate([one.base for one in finished])
    # Neighbours lie beside each other in memory, as those of the mesh do.
    order = np.argsort(base, kind="stable")
    whole = _Part(
        np.concatenate([one.corners for one in finished])[order], base[order],
        np.concatenate([one.places for one in finished])[order],
    )  # fmt: skip
    del finished
    return _interpolated(mesh, whole, points)


def _measured(mesh: Mesh, dicing: Dicing) -> tuple[np.ndarray, np.ndarray]:
    """Positions in the space in which edges are measured, and how long they may be there."""
    finite = np.nan_to_num(mesh.vertices.astype(np.float64), posinf=0.0, neginf=0.0)
    positions = finite @ dicing.to_space[:, :3].T + dicing.to_space[:, 3]
    return positions, _lengths(dicing, positions)


def _lengths(dicing: Dicing, positions: np.ndarray) -> np.ndarray:
    return np.maximum(dicing.lengths_at(positions), _LEAST)


def _first(mesh: Mesh, dicing: Dicing) -> tuple[_Part, _Points]:
    """Triangles and vertices of a mesh as it is."""
    count = len(mesh.triangles)
    corners = mesh.triangles.astype(np.int64)
    places = np.tile(np.array([[0, 0], [1, 0], [0, 1]], np.float32), (count, 1, 1))
    part = _Part(corners, np.arange(count, dtype=np.int32), places)
    of_corner = np.zeros(len(mesh.vertices), np.int64)
    of_corner[corners.reshape(-1)] = np.arange(3 * count)
    positions, lengths = _measured(mesh, dicing)
    return part, _Points(positions, lengths, (of_corner // 3).astype(np.int32), places.reshape(-1, 2)[of_corner])


def _halve(part: _Part, points: _Points, dicing: Dicing) -> tuple[_Part, _Points, _Part]:
    """Triangles divided once, vertices with those in between, and the triangles that were short enough."""
    following = np.roll(part.corners, -1, axis=1)
    is_long = _are_long(points, part.corners, following)
    is_divided = is_long.any(axis=1)
    rest, part, is_long = part.rows(~is_divided), part.rows(is_divided), is_long[is_divided]
    following = following[is_divided]
    rows, edges = np.nonzero(is_long)
    ends = np.sort(np.stack([part.corners[rows, edges], following[rows, edges]], axis=1), axis=1)
    count = len(points.lengths)
    _, first, of_edge = np.unique(ends[:, 0] * count + ends[:, 1], return_index=True, return_inverse=True)
    middles = np.full(part.corners.shape, -1, np.int64)
    middles[rows, edges] = count + of_edge.reshape(-1)
    places = 0.5 * (part.places + np.roll(part.places, -1, axis=1))
    low, high = ends[first].T
    between = 0.5 * (points.positions[low] + points.positions[high])
    points = _Points(
        np.concatenate([points.positions, between]),
        np.concatenate([points.lengths, _lengths(dicing, between)]),
        np.concatenate([points.base, part.base[rows[first]]]),
        np.concatenate([points.places, places[rows[first], edges[first]]]),
    )
    six = _Part(
        np.concatenate([part.corners, middles], axis=1), part.base, np.concatenate([part.places, places], axis=1)
    )
    return _divided(six, is_long, points.positions), points, rest


def _are_long(points: _Points, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Which edges are too long: by the longer half, as Cycles measures them."""
    gaps = points.positions[a] - points.positions[b]
    squared = np.einsum("ijk,ijk->ij", gaps, gaps)
    first, second = points.lengths[a], points.lengths[b]
    low, high = np.minimum(first, second), np.maximum(first, second)
    wanted = _TOO_LONG * (0.75 * low + 0.25 * high)
    result: np.ndarray = squared > wanted * wanted
    return result


def _divided(six: _Part, is_long: np.ndarray, positions: np.ndarray) -> _Part:
    """What triangles with three corners and three middles become."""
    counts = is_long.sum(axis=1)
    parts = []
    for halved in (1, 2, 3):
        rows = np.flatnonzero(counts == halved)
        # The first edge is the one that is halved, or that behind which the other is.
        flags = is_long[rows]
        turn = np.argmax(flags & ~np.roll(flags, 1, axis=1), axis=1) if halved < 3 else np.zeros(len(rows), np.int64)
        own = (np.arange(3) + turn[:, None]) % 3
        columns = np.concatenate([own, own + 3], axis=1)
        turned = _Part(
            np.take_along_axis(six.corners[rows], columns, axis=1), six.base[rows],
            np.take_along_axis(six.places[rows], columns[:, :, None], axis=1),
        )  # fmt: skip
        if halved == 1:
            parts += [_chosen(turned, triple) for triple in _HALVED_ONE]
        elif halved == 3:
            parts += [_chosen(turned, triple) for triple in _HALVED_ALL]
        else:
            across = [positions[turned.corners[:, a]] - positions[turned.corners[:, b]] for a, b in ((0, 4), (3, 2))]
            is_shorter = (across[0] ** 2).sum(axis=1) <= (across[1] ** 2).sum(axis=1)
            parts += [_chosen(turned.rows(is_shorter), triple) for triple in _HALVED_TWO]
            parts += [_chosen(turned.rows(~is_shorter), triple) for triple in _HALVED_TWO_OTHERWISE]
    return _Part(
        np.concatenate([one.corners for one in parts]), np.concatenate([one.base for one in parts]),
        np.concatenate([one.places for one in parts]),
    )  # fmt: skip


def _chosen(six: _Part, triple: tuple[int, ...]) -> _Part:
    columns = list(triple)
    return _Part(six.corners[:, columns], six.base, six.places[:, columns])


def _interpolated(mesh: Mesh, part: _Part, points: _Points) -> Mesh:
    """A mesh's arrays at new vertices and corners; directions stay unit vectors."""
    corners = mesh.triangles[points.base]
    weights = _weights(points.places)

    def at_points(values: np.ndarray) -> Float32Array:
        result = weights[:, 0, None] * values[corners[:, 0]]
        for k in (1, 2):
            result += weights[:, k, None] * values[corners[:, k]]
        return result

    def at_corners(values: np.ndarray) -> Float32Array:
        """From (T, 3, width)."""
        result = np.empty((len(part.base), 3, values.shape[2]), np.float32)
        for corner in range(3):
            of_corner = _weights(part.places[:, corner])
            result[:, corner] = np.einsum("nk,nkw->nw", of_corner, values[part.base])
        return result

    attributes = {}
    for name, attribute in mesh.attributes.items():
        data = attribute.data
        if attribute.domain == "POINT":
            made = at_points(data)
            data = unit_vectors(made) if name == VERTEX_NORMALS else made
        elif attribute.domain == "CORNER":
            data = at_corners(data.reshape(len(mesh.triangles), 3, -1)).reshape(-1, data.shape[1])
        elif attribute.domain == "FACE":
            data = data[part.base]
        attributes[name] = Attribute(attribute.domain, data)
    normals, motion, motion_normals = mesh.corner_normals, mesh.motion_vertices, mesh.motion_normals
    return replace(
        mesh,
        key=("diced", mesh.key),
        vertices=at_points(mesh.vertices),
        triangles=part.corners.astype(np.uint32),
        corner_normals=None if normals is None else unit_vectors(at_corners(normals)),
        material_slots=mesh.material_slots[part.base],
        attributes=attributes,
        motion_vertices=None if motion is None else np.stack([at_points(step) for step in motion]),
        motion_normals=None
        if motion_normals is None
        else np.stack([unit_vectors(at_corners(step)) for step in motion_normals]),
        dicing=None,
    )


def _weights(places: np.ndarray) -> np.ndarray:
    """Barycentric weights of all three corners, float32 (N, 3)."""
    return np.concatenate([1.0 - places.sum(axis=1, keepdims=True), places], axis=1).astype(np.float32)
