# SPDX-License-Identifier: GPL-3.0-or-later
"""Cells of surface in a hash table: what all fields of such cells share.

A cell is a cube of a grid by one of six directions that its surface faces, and by the surface's shader. A field is a
bundle with `tag`, uint32 (S,), by which a cell knows its place again (0: the place is free), and `mask`, uint32 (1,),
S - 1; S is a power of two.

References
----------
Binder et al. 2019, "Massively Parallel Path Space Filtering" (cells in a hash table).
"""


import numpy as np

from engine.array_types import Float32Array
from engine.kernels.rounding import floor_of
from engine.runtime.jit import kernel

_DIRECTION_COUNT = 6
_OUTERMOST_PERCENT = 2.0


def extent_of(position: Float32Array) -> float:
    """Extent of where all but the outermost of these points, float32 (N, 3) [m], lie; above 0."""
    low, high = np.percentile(position, (_OUTERMOST_PERCENT, 100.0 - _OUTERMOST_PERCENT), axis=0)
    return max(float((high - low).max()), 1e-6 * float(np.abs(position).max()), 1e-30)


@kernel
def _facing(n):
    """Which of six directions a unit normal is nearest to: int in [0, 6)."""
    x, y, z = abs(n[0]), abs(n[1]), abs(n[2])
    if x >= y and x >= z:
        return 0 if n[0] >= 0.0 else 1
    if y >= z:
        return 2 if n[1] >= 0.0 else 3
    return 4 if n[2] >= 0.0 else 5


@kernel
def grid_cell(p, n, kind, inverse_size):
    """What makes a cell: its three coordinates in the grid, and a number of its kind and direction, four uint32.

    Parameters
    ----------
    p : tuple of 3 float32, world [m]; n : tuple of 3 float32, unit
    kind : int, of what else is apart: shader and size of cells
    inverse_size : float32 [1 / m]
    """
    x = np.uint32(floor_of(p[0] * inverse_size) & 0xFFFFFFFF)
    y = np.uint32(floor_of(p[1] * inverse_size) & 0xFFFFFFFF)
    z = np.uint32(floor_of(p[2] * inverse_size) & 0xFFFFFFFF)
    return x, y, z, np.uint32(kind * _DIRECTION_COUNT + _facing(n))


@kernel
def find_place(field, place, tag, probe_count):
    """Where in a field's table a cell is, -1 where it is not.

    Parameters
    ----------
    place : int, the first place of the cell; tag : uint32, not 0
    probe_count : int, places that a cell may be in
    """
    for probe in range(probe_count):
        slot = (place + probe) & np.int64(field.mask[0])
        found = field.tag[slot]
        if found == tag:
            return slot
        if found == np.uint32(0):
            return np.int64(-1)
    return np.int64(-1)


@kernel
def claim_place(field, place, tag, probe_count):
    """Where in a field's table a cell is, made if there is none; -1 where the table has no room near.

    Parameters
    ----------
    place, tag, probe_count
        As for `find_place`.
    """
    for probe in range(probe_count):
        slot = (place + probe) & np.int64(field.mask[0])
        if field.tag[slot] == np.uint32(0):
            field.tag[slot] = tag
        if field.tag[slot] == tag:
            return slot
    return np.int64(-1)
