# SPDX-License-Identifier: GPL-3.0-or-later
"""Which vertices of a mesh hang together by its edges, and which lie in one place; numbered as Cycles numbers them."""

from __future__ import annotations

import numpy as np

from engine.array_types import Float32Array, Int32Array, Int64Array
from engine.runtime.jit import kernel

#: Squared distance of vertices that are one [m^2], and by how much the sums of their coordinates may differ [m].
_ONE_PLACE = np.float32(2.0**-23)
_SUMS = np.float32(3.0 * 2.0**-23)


@kernel
def _root_of(parents, vertex):
    root = vertex
    while parents[root] != root:
        root = parents[root]
    while parents[vertex] != root:
        parents[vertex], vertex = root, parents[vertex]
    return root


@kernel
def _join(ends, parents, ranks):
    for k in range(ends.shape[0]):
        a = _root_of(parents, np.int64(ends[k, 0]))
        b = _root_of(parents, np.int64(ends[k, 1]))
        if a != b:
            if ranks[a] < ranks[b]:
                a, b = b, a
            parents[b] = a
            if ranks[a] == ranks[b]:
                ranks[a] += 1
    for vertex in range(parents.shape[0]):
        parents[vertex] = _root_of(parents, np.int64(vertex))


@kernel
def _weld(order, positions, original):
    count = order.shape[0]
    for k in range(count):
        vertex = order[k]
        x, y, z = positions[vertex, 0], positions[vertex, 1], positions[vertex, 2]
        for m in range(k + 1, count):
            other = order[m]
            u, v, w = positions[other, 0], positions[other, 1], positions[other, 2]
            if (u + v + w) - (x + y + z) > _SUMS:
                break
            if (u - x) * (u - x) + (v - y) * (v - y) + (w - z) * (w - z) < _ONE_PLACE:
                original[vertex] = other
                break
    for vertex in range(count):
        first = original[vertex]
        while original[first] != first:
            first = original[first]
        original[vertex] = first


def island_roots(ends: Int32Array, vertex_count: int) -> Int64Array:
    """One vertex for all that edges connect, by union by rank (Tarjan 1975), edge by edge.

    Parameters
    ----------
    ends : int32 (E, 2)
    vertex_count : int

    Returns
    -------
    int64 (vertex_count,)
    """
    parents = np.arange(vertex_count)
    _join(np.ascontiguousarray(ends, np.int32).reshape(-1, 2), parents, np.zeros(vertex_count, np.int64))
    return parents


def welded_vertices(positions: Float32Array) -> Int64Array:
    """One vertex for all that lie in one place, int64 (V,), of positions float32 (V, 3)."""
    positions = np.ascontiguousarray(positions, np.float32)
    numbers = np.arange(len(positions))
    sums = positions[:, 0] + positions[:, 1] + positions[:, 2]
    order = np.lexsort((-numbers, *positions.T, sums))
    original = numbers.copy()
    _weld(order, positions, original)
    return original
