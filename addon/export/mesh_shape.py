# SPDX-License-Identifier: GPL-3.0-or-later
"""Attributes that Cycles makes of a mesh's shape: Random Per Island and Pointiness."""

from __future__ import annotations

import bpy
import numpy as np

from engine.array_types import Float32Array, Int32Array
from engine.scene.connected_vertices import island_roots, welded_vertices

from .hashes import hash_word_to_unit
from .normals import read_vertex_normals
from .positions import read_positions
from .topology import Topology


def _edges(mesh: bpy.types.Mesh) -> Int32Array:
    ends = np.empty(2 * len(mesh.edges), np.int32)
    mesh.edges.foreach_get("vertices", ends)
    return ends.reshape(-1, 2)


def random_per_island(mesh: bpy.types.Mesh, topology: Topology) -> Float32Array:
    """A random number of what edges connect, for each triangle, float32 (T, 1)."""
    roots = island_roots(_edges(mesh), len(mesh.vertices))
    return hash_word_to_unit(roots[topology.vertices[:, 0]])[:, None]


def pointiness(mesh: bpy.types.Mesh) -> Float32Array:
    """How far the edges around a vertex bend away from its normal, as an angle over pi, float32 (V, 1).

    It is 0.5 where a surface is flat, and a mean with the vertices around; vertices in one place are one.
    """
    positions = read_positions(mesh)
    count = len(positions)
    original = welded_vertices(positions)
    normals = _sum_by(original, read_vertex_normals(mesh), count)
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-30)
    ends = np.sort(original[_edges(mesh)], axis=1)
    _, first = np.unique(ends[:, 0] * count + ends[:, 1], return_index=True)
    ends = ends[first]
    edges = positions[ends[:, 1]].astype(np.float64) - positions[ends[:, 0]]
    edges /= np.maximum(np.linalg.norm(edges, axis=1, keepdims=True), 1e-30)
    around = _sum_by(ends[:, 0], edges, count) - _sum_by(ends[:, 1], edges, count)
    degree = np.bincount(ends.ravel(), minlength=count)
    cosine = np.einsum("vi,vi->v", normals, around) / np.maximum(degree, 1)
    sharp = np.where(degree > 0, np.arccos(np.clip(cosine, -1.0, 1.0)) / np.pi, 0.0)
    blurred = sharp + np.bincount(ends[:, 0], sharp[ends[:, 1]], count)
    blurred += np.bincount(ends[:, 1], sharp[ends[:, 0]], count)
    return (blurred / (degree + 1))[original].astype(np.float32)[:, None]


def _sum_by(row: np.ndarray, values: np.ndarray, count: int) -> np.ndarray:
    """Sums of values, (N, 3), that go to each row, float64 (count, 3)."""
    return np.stack([np.bincount(row, values[:, axis], count) for axis in range(3)], axis=1)
