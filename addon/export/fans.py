# SPDX-License-Identifier: GPL-3.0-or-later
"""Which corners of a vertex stay together where Cycles splits meshes at sharp edges."""

from __future__ import annotations

import bpy
import numpy as np
import numpy.typing as npt

from engine.array_types import Float32Array, Int32Array

from .topology import read_corner_vertices


def read_fans(mesh: bpy.types.Mesh) -> Float32Array | None:
    """A number for each corner, (corners,), alike for those of a vertex that no sharp edge parts; None: none does."""
    stored = mesh.attributes.get("sharp_edge")
    if stored is None:
        return None
    is_sharp = np.empty(len(mesh.edges), bool)
    stored.data.foreach_get("value", is_sharp)
    is_flat = np.empty(len(mesh.polygons), bool)
    mesh.polygons.foreach_get("use_smooth", is_flat)
    np.logical_not(is_flat, out=is_flat)
    starts, totals = (np.empty(len(mesh.polygons), np.int32) for _ in range(2))
    mesh.polygons.foreach_get("loop_start", starts)
    mesh.polygons.foreach_get("loop_total", totals)
    edges = np.empty(len(mesh.loops), np.int32)
    mesh.loops.foreach_get("edge_index", edges)
    # Edges of flat faces are sharp too.
    is_sharp[edges[np.repeat(is_flat, totals)]] = True
    if not is_sharp.any():
        return None
    following = np.arange(1, len(edges) + 1, dtype=np.int32)
    following[starts + totals - 1] = starts
    return fans_of(read_corner_vertices(mesh), edges, following, is_sharp)


def fans_of(
    vertices: Int32Array, edges: Int32Array, following: Int32Array, is_sharp: npt.NDArray[np.bool_]
) -> Float32Array:
    """Fans by corner: the smallest corner that belongs to each, counted within its vertex.

    Parameters
    ----------
    vertices, edges, following : int32 (corners,)
        Vertex of each corner, the edge from it to the next of its face, and that next one.
    is_sharp : bool (edges,)
    """
    order = np.argsort(edges, kind="stable")
    first, second = order[:-1], order[1:]
    joined = (edges[first] == edges[second]) & ~is_sharp[edges[first]]
    first, second = first[joined], second[joined]
    # The other face goes along the edge the other way, unless it is turned over.
    is_alike = vertices[first] == vertices[second]
    pairs = np.concatenate([
        np.stack([first, np.where(is_alike, second, following[second])], axis=1),
        np.stack([following[first], np.where(is_alike, following[second], second)], axis=1),
    ])  # fmt: skip
    fans = np.arange(len(vertices))
    while True:
        low = fans[pairs].min(axis=1)
        before = fans.copy()
        np.minimum.at(fans, pairs[:, 0], low)
        np.minimum.at(fans, pairs[:, 1], low)
        if np.array_equal(fans, before):
            break
    # Counted from 0 at each vertex: small numbers are exact as floats.
    different, of_corner = np.unique(np.stack([vertices, fans], axis=1), axis=0, return_inverse=True)
    firsts = np.searchsorted(different[:, 0], different[:, 0])
    return (np.arange(len(different)) - firsts)[of_corner.reshape(-1)].astype(np.float32)
