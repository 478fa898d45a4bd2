# SPDX-License-Identifier: GPL-3.0-or-later
"""What dicing does for each triangle and edge of a mesh.

An edge that is short enough has no number, -1: nothing asks for it again. The others are numbered from 0, and the
middle of edge `e` is vertex `first_middle + e`.
"""

from __future__ import annotations

import numpy as np

from engine.array_types import Float32Array, Int32Array
from engine.runtime.bundle import Bundle
from engine.runtime.jit import kernel


class Triangles(Bundle):
    """N triangles on their way to be divided.

    corners, edges : int32 (N, 3), edge k lies between corners k and k + 1
    base : int32 (N,), the triangle of the mesh that each lies in
    places : float32 (N, 3, 2), of the corners in that, as weights of its second and third corner
    """

    corners: Int32Array
    edges: Int32Array
    base: Int32Array
    places: Float32Array


def allocate_triangles(count: int) -> Triangles:
    """Room for so many."""
    return Triangles(
        np.empty((count, 3), np.int32), np.empty((count, 3), np.int32), np.empty(count, np.int32),
        np.empty((count, 3, 2), np.float32),
    )  # fmt: skip


@kernel(float64_literals=True)
def number_long_edges(ends, positions, lengths, factor, numbers):
    """Write the number of each edge that is too long, and -1 for the others; returns how many are.

    An edge is compared with the lengths that it may have at its longer half, as Cycles measures edges.

    Parameters
    ----------
    ends : int32 (E, 2)
    positions, lengths : float64 (V, 3), (V,)
    factor : float64
        By how much edges may be longer.
    numbers : int32 (E,)
    """
    count = 0
    for edge in range(ends.shape[0]):
        a = ends[edge, 0]
        b = ends[edge, 1]
        x = positions[a, 0] - positions[b, 0]
        y = positions[a, 1] - positions[b, 1]
        z = positions[a, 2] - positions[b, 2]
        low = min(lengths[a], lengths[b])
        high = max(lengths[a], lengths[b])
        wanted = factor * (0.75 * low + 0.25 * high)
        numbers[edge] = -1
        if x * x + y * y + z * z > wanted * wanted:
            numbers[edge] = count
            count += 1
    return count


@kernel
def halve_edges(ends, first_middle, half_ends, positions):
    """Write the ends of both halves of each edge, int32 (2 E, 2), and the middles behind the other positions."""
    for edge in range(ends.shape[0]):
        middle = first_middle + edge
        half_ends[2 * edge, 0] = ends[edge, 0]
        half_ends[2 * edge, 1] = middle
        half_ends[2 * edge + 1, 0] = middle
        half_ends[2 * edge + 1, 1] = ends[edge, 1]
        for axis in range(3):
            total = positions[ends[edge, 0], axis] + positions[ends[edge, 1], axis]
            positions[middle, axis] = total / 2


@kernel
def _squared_distance(positions, a, b):
    x = positions[a, 0] - positions[b, 0]
    y = positions[a, 1] - positions[b, 1]
    z = positions[a, 2] - positions[b, 2]
    return x * x + y * y + z * z


@kernel
def _half_at(ends, edge, vertex):
    """Number of the half of an edge that begins or ends at one of its ends; -1 = the edge is not divided."""
    if edge < 0:
        return -1
    if ends[edge, 0] == vertex:
        return 2 * edge
    return 2 * edge + 1


@kernel
def _between(a, b):
    return (0.5 * (a[0] + b[0]), 0.5 * (a[1] + b[1]))


@kernel
def _add_triangle(made, row, base, corners, edges, places):
    made.base[row] = base
    for k in range(3):
        made.corners[row, k] = corners[k]
        made.edges[row, k] = edges[k]
        made.places[row, k, 0] = places[k][0]
        made.places[row, k, 1] = places[k][1]


@kernel
def _keep_middle(point_base, point_places, vertex, base, place):
    point_base[vertex] = base
    point_places[vertex, 0] = place[0]
    point_places[vertex, 1] = place[1]


@kernel
def _first_long_edge(edges, t):
    """A long edge of a triangle behind a short one; the first where all are long."""
    for k in range(3):
        if edges[t, k] >= 0 and edges[t, (k + 2) % 3] < 0:
            return k
    return 0


@kernel
def divide_triangles(whole, ends, first_middle, positions, made, inner_ends, point_base, point_places):
    """Divide triangles with long edges into two, three or four: what a triangle becomes lies together.

    Edges of what is made have the numbers of halves of `ends`, then those of edges inside of triangles.

    Parameters
    ----------
    whole, made : Triangles
        Each of `whole` has a long edge at least.
    ends : int32 (E, 2)
        Of long edges.
    inner_ends : int32 (I, 2)
        Written: ends of edges inside of triangles.
    point_base, point_places : int32 (V,), float32 (V, 2)
        Written for middles: the triangle of the mesh that each lies in, and where.
    """
    row = inner = 0
    first_inner = 2 * ends.shape[0]
    for t in range(whole.base.shape[0]):
        base = whole.base[t]
        turn = _first_long_edge(whole.edges, t)
        j = (turn + 1) % 3
        k = (turn + 2) % 3
        a, b, c = np.int64(whole.corners[t, turn]), np.int64(whole.corners[t, j]), np.int64(whole.corners[t, k])
        ab, bc, ca = np.int64(whole.edges[t, turn]), np.int64(whole.edges[t, j]), np.int64(whole.edges[t, k])
        at_a = (whole.places[t, turn, 0], whole.places[t, turn, 1])
        at_b = (whole.places[t, j, 0], whole.places[t, j, 1])
        at_c = (whole.places[t, k, 0], whole.places[t, k, 1])
        at_ab = _between(at_a, at_b)
        m = first_middle + ab
        _keep_middle(point_base, point_places, m, base, at_ab)
        if bc < 0:
            inner_ends[inner, 0], inner_ends[inner, 1] = m, c
            mc = first_inner + inner
            inner += 1
            _add_triangle(made, row, base, (a, m, c), (_half_at(ends, ab, a), mc, ca), (at_a, at_ab, at_c))
            _add_triangle(made, row + 1, base, (m, b, c), (_half_at(ends, ab, b), bc, mc), (at_ab, at_b, at_c))
            row += 2
            continue
        at_bc = _between(at_b, at_c)
        n = first_middle + bc
        _keep_middle(point_base, point_places, n, base, at_bc)
        inner_ends[inner, 0], inner_ends[inner, 1] = m, n
        mn = first_inner + inner
        inner += 1
        _add_triangle(
            made, row, base, (m, b, n), (_half_at(ends, ab, b), _half_at(ends, bc, b), mn), (at_ab, at_b, at_bc)
        )
        row += 1
        if ca < 0:
            # What is left has four corners: its shorter diagonal divides it.
            across = first_inner + inner
            if _squared_distance(positions, a, n) <= _squared_distance(positions, m, c):
                inner_ends[inner, 0], inner_ends[inner, 1] = a, n
                _add_triangle(made, row, base, (a, m, n), (_half_at(ends, ab, a), mn, across), (at_a, at_ab, at_bc))
                _add_triangle(made, row + 1, base, (a, n, c), (across, _half_at(ends, bc, c), ca), (at_a, at_bc, at_c))
            else:
                inner_ends[inner, 0], inner_ends[inner, 1] = m, c
                _add_triangle(made, row, base, (a, m, c), (_half_at(ends, ab, a), across, ca), (at_a, at_ab, at_c))
                _add_triangle(made, row + 1, base, (m, n, c), (mn, _half_at(ends, bc, c), across), (at_ab, at_bc, at_c))
            inner += 1
            row += 2
            continue
        at_ca = _between(at_c, at_a)
        o = first_middle + ca
        _keep_middle(point_base, point_places, o, base, at_ca)
        inner_ends[inner, 0], inner_ends[inner, 1] = n, o
        inner_ends[inner + 1, 0], inner_ends[inner + 1, 1] = o, m
        no = first_inner + inner
        om = no + 1
        inner += 2
        _add_triangle(
            made, row, base, (a, m, o), (_half_at(ends, ab, a), om, _half_at(ends, ca, a)), (at_a, at_ab, at_ca)
        )
        _add_triangle(
            made, row + 1, base, (o, n, c), (no, _half_at(ends, bc, c), _half_at(ends, ca, c)), (at_ca, at_bc, at_c)
        )
        _add_triangle(made, row + 2, base, (m, n, o), (mn, no, om), (at_ab, at_bc, at_ca))
        row += 3
    return row


@kernel
def interpolate(values, base, places, corner_count, out):
    """Write values at places in triangles.

    Parameters
    ----------
    values : float32 (T, 3, width)
    base : int32 (N,)
    places : float32 (N * corner_count, 2)
    out : float32 (N * corner_count, width)
    """
    for row in range(out.shape[0]):
        t = base[row // corner_count]
        u = places[row, 0]
        v = places[row, 1]
        first = 1.0 - u - v
        for k in range(out.shape[1]):
            out[row, k] = first * values[t, 0, k] + u * values[t, 1, k] + v * values[t, 2, k]
