# SPDX-License-Identifier: GPL-3.0-or-later
"""`CellField`: mean radiance that surfaces send back, by cell, in a hash table of several cell sizes.

A cell is a cube of a grid by one of six directions that its surface faces, and by the surface's shader: so the two
sides of a thin wall, the walls of a corner, and things of different colours are apart. Each size is twice the next
smaller one.

References
----------
Binder et al. 2019, "Massively Parallel Path Space Filtering" (cells in a hash table).
"""

import math

import numpy as np

from engine.array_types import Float32Array, Uint32Array
from engine.kernels.rng import hash_combine
from engine.runtime.bundle import Bundle
from engine.runtime.jit import kernel
from engine.state.lanes import aligned_bytes

#: Sizes of cells: the largest is 2^(LEVEL_COUNT - 1) times the smallest.
LEVEL_COUNT = 6
#: Places of the table, a power of two, and how many of them a cell may be in.
SLOT_COUNT = 1 << 20
_PROBE_COUNT = 8
_DIRECTION_COUNT = 6

# Columns of the sums, after those of radiance.
SUM_WEIGHT = 3
SUM_COUNT = 6
SUM_WIDTH = 7
#: A place of the table [numbers], two to a cache line: the sums, then the tag.
_PLACE_WIDTH = 8


class CellField(Bundle):
    """Cells of surface, S places.

    tag : uint32 (S,), by which a cell knows its place again; 0: the place is free
    sums : float32 (S, SUM_WIDTH), of what was recorded in the cell: weight times radiance by channel, weight by
        channel, number of records
    size : float32 (1,) [m], side of the smallest cells
    mask : uint32 (1,), S - 1
    """

    _rows = True
    tag: Uint32Array
    sums: Float32Array
    size: Float32Array
    mask: Uint32Array


def empty_cells(size: float = 1.0, slot_count: int = SLOT_COUNT) -> CellField:
    """A field that knows nothing, with room for so many cells, the smallest of this size [m]."""
    places = aligned_bytes(slot_count * _PLACE_WIDTH * 4).view(np.float32).reshape(slot_count, _PLACE_WIDTH)
    return CellField(
        places.view(np.uint32)[:, SUM_WIDTH], places[:, :SUM_WIDTH], np.full(1, size, np.float32),
        np.full(1, slot_count - 1, np.uint32),
    )


def no_cells() -> CellField:
    """A field of which nothing is asked."""
    return empty_cells(slot_count=1)


@kernel
def cell_size(cells, level):
    """Side of the cells of a level [m], float32."""
    return cells.size[0] * np.float32(1 << level)


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
def cell_key(cells, p, n, program, level):
    """First place, and tag (not 0), of the cell of a level at p on the side that n faces: int, uint32.

    Parameters
    ----------
    p : tuple of 3 float32, world [m]; n : tuple of 3 float32, unit
    program : int, of the surface's shader
    """
    inverse = np.float32(1.0) / cell_size(cells, level)
    x = np.uint32(np.int64(math.floor(p[0] * inverse)) & 0xFFFFFFFF)
    y = np.uint32(np.int64(math.floor(p[1] * inverse)) & 0xFFFFFFFF)
    z = np.uint32(np.int64(math.floor(p[2] * inverse)) & 0xFFFFFFFF)
    kind = np.uint32((program * LEVEL_COUNT + level) * _DIRECTION_COUNT + _facing(n))
    first, second = hash_combine(x, y), hash_combine(z, kind)
    key, tag = hash_combine(first, second), hash_combine(second, first)
    return np.int64(key & cells.mask[0]), max(tag, np.uint32(1))


@kernel
def find_cell(cells, place, tag):
    """Where in the table a cell is (`cell_key`), -1 where there is none."""
    for probe in range(_PROBE_COUNT):
        slot = (place + probe) & np.int64(cells.mask[0])
        found = cells.tag[slot]
        if found == tag:
            return slot
        if found == np.uint32(0):
            return np.int64(-1)
    return np.int64(-1)


@kernel
def claim_cell(cells, place, tag):
    """Where in the table a cell is, made if there is none; -1 where the table has no room near."""
    for probe in range(_PROBE_COUNT):
        slot = (place + probe) & np.int64(cells.mask[0])
        if cells.tag[slot] == np.uint32(0):
            cells.tag[slot] = tag
        if cells.tag[slot] == tag:
            return slot
    return np.int64(-1)
