# SPDX-License-Identifier: GPL-3.0-or-later
"""Divides the triangles of meshes until their edges are as short as wanted, without cracks.

Whether an edge is halved depends on its two ends alone, so that both triangles beside it agree. Triangles are divided
into two, three or four, by how many of their edges are (Bank, Sherman and Weiser 1983, red and green refinement).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from engine.array_types import Float32Array, Int32Array
from engine.builder.dicing_kernels import (
    Triangles,
    allocate_triangles,
    divide_triangles,
    halve_edges,
    interpolate,
    number_long_edges,
)
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
#: Places at which lengths are looked up to know how many there will be.
_LOOKS = 1 << 16
#: No edge need be shorter.
_LEAST = 1e-12
#: Where a triangle's corners lie in it.
_CORNERS = np.array([[0, 0], [1, 0], [0, 1]], np.float32)


@dataclass
class _Points:
    """Vertices: positions (N, 3), lengths (N,), and the triangle of the mesh that each lies in, and where, (N, 2)."""

    positions: npt.NDArray[np.float64]
    lengths: npt.NDArray[np.float64]
    base: Int32Array
    places: Float32Array

    def grow(self, count: int) -> None:
        """Make room for more vertices."""
        self.positions = np.concatenate([self.positions, np.empty((count, 3))])
        self.lengths = np.concatenate([self.lengths, np.empty(count)])
        self.base = np.concatenate([self.base, np.empty(count, np.int32)])
        self.places = np.concatenate([self.places, np.empty((count, 2), np.float32)])


@dataclass
class _Diced:
    """Triangles that are short enough: their corners' numbers (N, 3), triangle of the mesh, and where, (N, 3, 2)."""

    corners: Int32Array
    base: Int32Array
    places: Float32Array


def dice(mesh: Mesh, dicing: Dicing, check_cancel: Callable[[], None] = lambda: None) -> Mesh:
    """A mesh with its triangles divided.

    Raises
    ------
    ValueError
        Where there is no memory for that, naming the mesh and how many triangles it would be.
    """
    check_memory_of(estimated_count(mesh, dicing), f"mesh {mesh.name}, diced for its displacement,")
    return diced(mesh, dicing, check_cancel)


def estimated_count(mesh: Mesh, dicing: Dicing) -> int:
    """About how many triangles there will be: lengths are looked up at places all over the mesh's triangles."""
    if not len(mesh.triangles):
        return 0
    corners = _measured(mesh, dicing)[0][mesh.triangles]
    edges = corners[:, 1:] - corners[:, :1]
    with np.errstate(invalid="ignore", over="ignore"):
        areas = 0.5 * np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=1)
        weights = _centers(max(int(math.sqrt(_LOOKS / len(corners))), 1))
        points = np.einsum("pk,tkx->tpx", weights, corners)
        shares = np.square(1.0 / _lengths(dicing, points.reshape(-1, 3))).reshape(len(corners), -1).mean(axis=1)
        counts = _TRIANGLES_PER_SQUARE * areas * shares
    most = 4.0**dicing.level
    return int(np.clip(np.nan_to_num(counts, posinf=most), 1.0, most).sum())


def _centers(parts: int) -> np.ndarray:
    """Barycentrics of the centres of parts^2 equal triangles that a triangle consists of, (parts^2, 3)."""
    i, j = np.divmod(np.arange(parts * parts), parts)
    upright = np.stack([i, j], axis=1)[i + j < parts] + 1.0 / 3.0
    turned = np.stack([i, j], axis=1)[i + j < parts - 1] + 2.0 / 3.0
    places = np.concatenate([upright, turned]) / parts
    return np.concatenate([1.0 - places.sum(axis=1, keepdims=True), places], axis=1)


def diced(mesh: Mesh, dicing: Dicing, check_cancel: Callable[[], None] = lambda: None) -> Mesh:
    """A mesh with its triangles divided."""
    if not len(mesh.triangles) or int(mesh.triangles.max()) >= len(mesh.vertices):
        return replace(mesh, dicing=None)
    points = _points_of(mesh, dicing)
    corners = mesh.triangles.astype(np.int32)
    every = np.stack([corners, np.roll(corners, -1, axis=1)], axis=2).reshape(-1, 2)
    ends, edges = np.unique(np.sort(every, axis=1), axis=0, return_inverse=True)
    ends, numbers = _long_edges(ends, points)
    places = np.tile(_CORNERS, (len(corners), 1, 1))
    whole = Triangles(corners, numbers[edges.reshape(-1, 3)], np.arange(len(corners), dtype=np.int32), places)
    finished: list[_Diced] = []
    for _ in range(dicing.level):
        check_cancel()
        whole = _take_finished(whole, finished)
        if not len(whole.base):
            break
        whole, ends = _divided(whole, ends, points, dicing)
    finished.append(_Diced(whole.corners, whole.base, whole.places))
    return _interpolated(mesh, _in_order(finished), points.base, points.places)


def _measured(mesh: Mesh, dicing: Dicing) -> tuple[np.ndarray, np.ndarray]:
    """Positions in the space in which edges are measured, and how long they may be there."""
    finite = np.nan_to_num(mesh.vertices.astype(np.float64), posinf=0.0, neginf=0.0)
    positions = finite @ dicing.to_space[:, :3].T + dicing.to_space[:, 3]
    return positions, _lengths(dicing, positions)


def _lengths(dicing: Dicing, positions: np.ndarray) -> np.ndarray:
    return np.maximum(dicing.lengths_at(positions), _LEAST)


def _points_of(mesh: Mesh, dicing: Dicing) -> _Points:
    """Vertices of a mesh as it is."""
    corners = mesh.triangles.reshape(-1)
    of_corner = np.zeros(len(mesh.vertices), np.int32)
    of_corner[corners] = np.arange(len(corners), dtype=np.int32)
    positions, lengths = _measured(mesh, dicing)
    return _Points(positions, lengths, of_corner // 3, _CORNERS[of_corner % 3])


def _long_edges(ends: Int32Array, points: _Points) -> tuple[Int32Array, Int32Array]:
    """Ends of the edges that are too long, and each edge's number among them, -1 = none; at the end -1 once more."""
    numbers = np.full(len(ends) + 1, -1, np.int32)
    number_long_edges(ends, points.positions, points.lengths, _TOO_LONG, numbers[:-1])
    return ends[numbers[:-1] >= 0], numbers


def _take_finished(whole: Triangles, finished: list[_Diced]) -> Triangles:
    """Triangles with long edges; the others are added to those that are finished."""
    is_long = (whole.edges >= 0).any(axis=1)
    if is_long.all():
        return whole
    done = ~is_long
    finished.append(_Diced(whole.corners[done], whole.base[done], whole.places[done]))
    return Triangles(whole.corners[is_long], whole.edges[is_long], whole.base[is_long], whole.places[is_long])


def _divided(whole: Triangles, ends: Int32Array, points: _Points, dicing: Dicing) -> tuple[Triangles, Int32Array]:
    """What triangles become, vertices with the middles of long edges, and the ends of edges that still are too long."""
    inner_count = int(np.count_nonzero(whole.edges >= 0))
    made = allocate_triangles(len(whole.base) + inner_count)
    first_middle, halves = len(points.lengths), 2 * len(ends)
    made_ends = np.empty((halves + inner_count, 2), np.int32)
    points.grow(len(ends))
    halve_edges(ends, first_middle, made_ends[:halves], points.positions)
    points.lengths[first_middle:] = _lengths(dicing, points.positions[first_middle:])
    divide_triangles(
        whole, ends, first_middle, points.positions, made, made_ends[halves:], points.base, points.places
    )
    ends, numbers = _long_edges(made_ends, points)
    made.edges[:] = numbers[made.edges]
    return made, ends


def _in_order(parts: list[_Diced]) -> _Diced:
    """All of them: neighbours lie beside each other in memory, as those of the mesh do. Frees the parts."""
    base = np.concatenate([part.base for part in parts])
    order = np.argsort(base, kind="stable")
    corners = np.concatenate([part.corners for part in parts])[order]
    places = np.concatenate([part.places for part in parts])
    parts.clear()
    return _Diced(corners, base[order], places[order])


def _interpolated(mesh: Mesh, diced: _Diced, point_base: Int32Array, point_places: Float32Array) -> Mesh:
    """A mesh's arrays at new vertices and corners; directions stay unit vectors."""

    def at(values: np.ndarray, base: Int32Array, places: Float32Array) -> Float32Array:
        """From (T, 3, width): at one or three places in each of the triangles `base`."""
        places = places.reshape(-1, 2)
        result = np.empty((len(places), values.shape[2]), np.float32)
        interpolate(np.ascontiguousarray(values, np.float32), base, places, len(places) // max(len(base), 1), result)
        return result

    def at_points(values: np.ndarray) -> Float32Array:
        return at(values[mesh.triangles], point_base, point_places)

    def at_corners(values: np.ndarray) -> Float32Array:
        return at(values.reshape(len(mesh.triangles), 3, -1), diced.base, diced.places)

    attributes = {}
    for name, attribute in mesh.attributes.items():
        data = attribute.data
        if attribute.domain == "POINT":
            made = at_points(data)
            data = unit_vectors(made) if name == VERTEX_NORMALS else made
        elif attribute.domain == "CORNER":
            data = at_corners(data)
        elif attribute.domain == "FACE":
            data = data[diced.base]
        attributes[name] = Attribute(attribute.domain, data)
    normals, motion, motion_normals = mesh.corner_normals, mesh.motion_vertices, mesh.motion_normals
    return replace(
        mesh,
        key=("diced", mesh.key),
        vertices=at_points(mesh.vertices),
        triangles=diced.corners.view(np.uint32),
        corner_normals=None if normals is None else unit_vectors(at_corners(normals)).reshape(-1, 3, 3),
        material_slots=mesh.material_slots[diced.base],
        attributes=attributes,
        motion_vertices=None if motion is None else np.stack([at_points(step) for step in motion]),
        motion_normals=None
        if motion_normals is None
        else np.stack([unit_vectors(at_corners(step)).reshape(-1, 3, 3) for step in motion_normals]),
        dicing=None,
    )
