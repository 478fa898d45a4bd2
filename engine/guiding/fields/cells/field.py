# SPDX-License-Identifier: GPL-3.0-or-later
"""`CellField`: mean incident radiance by cell of surface, in a hash table of several cell sizes.

A cell is a cube of a grid by one of six directions that its surface faces, so that the two sides of a thin wall, and
the walls of a corner, are apart. Each size is twice the next smaller one. Whoever asks gets the smallest cell that
knows enough.

References
----------
Binder et al. 2019, "Massively Parallel Path Space Filtering" (cells in a hash table, jittered look-up).
"""

import math

import numpy as np

from engine.array_types import Float32Array, Uint32Array
from engine.kernels.rng import hash_combine
from engine.runtime.bundle import Bundle
from engine.runtime.jit import kernel

#: Sizes of cells: the largest is 2^(LEVEL_COUNT - 1) times the smallest.
LEVEL_COUNT = 6
#: Places of the table, a power of two, and how many of them a cell may be in.
SLOT_COUNT = 1 << 20
_PROBE_COUNT = 8
_DIRECTION_BITS = 8

# Columns of the sums, after those of radiance.
SUM_WEIGHT = 3
SUM_COUNT = 4
SUM_WIDTH = 5


class CellField(Bundle):
    """Cells of surface, S places.

    tags : uint32 (S,), by which a cell knows its place again; 0: the place is free
    sums : float32 (S, SUM_WIDTH), of what was recorded in the cell: weight times incident radiance by channel, weight
        (the share of the light that the surface sends on), number of records
    size : float32 (1,) [m], side of the smallest cells
    """

    tags: Uint32Array
    sums: Float32Array
    size: Float32Array


def no_cells() -> CellField:
    """A field that knows nothing."""
    return CellField(np.zeros(1, np.uint32), np.zeros((1, SUM_WIDTH), np.float32), np.ones(1, np.float32))


def empty_cells(size: float) -> CellField:
    """A field with room for cells, the smallest of this size [m]."""
    return CellField(
        np.zeros(SLOT_COUNT, np.uint32), np.zeros((SLOT_COUNT, SUM_WIDTH), np.float32), np.full(1, size, np.float32)
    )


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
def cell_key(cells, p, n, level):
    """Hash and tag (not 0) of the cell of a level at p, on the side that n faces: uint32, uint32."""
    inverse = 1.0 / cell_size(cells, level)
    x = np.uint32(np.int64(math.floor(p[0] * inverse)) & 0xFFFFFFFF)
    y = np.uint32(np.int64(math.floor(p[1] * inverse)) & 0xFFFFFFFF)
    z = np.uint32(np.int64(math.floor(p[2] * inverse)) & 0xFFFFFFFF)
    kind = np.uint32(level * _DIRECTION_BITS + _facing(n))
    key = hash_combine(hash_combine(x, y), hash_combine(z, kind))
    tag = hash_combine(hash_combine(z, x), hash_combine(kind, y))
    return key, max(tag, np.uint32(1))


@kernel
def find_cell(cells, p, n, level):
    """Place of a cell in the table, -1 where there is none."""
    key, tag = cell_key(cells, p, n, level)
    mask = np.uint32(cells.tags.shape[0] - 1)
    for probe in range(_PROBE_COUNT):
        slot = np.int64((key + np.uint32(probe)) & mask)
        found = cells.tags[slot]
        if found == tag:
            return slot
        if found == np.uint32(0):
            return -1
    return -1


@kernel
def claim_cell(cells, p, n, level):
    """Place of a cell in the table, made if there is none; -1 where the table has no room near."""
    key, tag = cell_key(cells, p, n, level)
    mask = np.uint32(cells.tags.shape[0] - 1)
    for probe in range(_PROBE_COUNT):
        slot = np.int64((key + np.uint32(probe)) & mask)
        if cells.tags[slot] == np.uint32(0):
            cells.tags[slot] = tag
        if cells.tags[slot] == tag:
            return slot
    return -1


@kernel
def find_known(cells, p, n, least_count):
    """The smallest cell at p that has seen enough.

    Parameters
    ----------
    p : tuple of 3 float32, world [m]; n : tuple of 3 float32, unit, on the side that is asked for
    least_count : float32, records

    Returns
    -------
    slot : int, -1: none; level : int
    """
    for level in range(LEVEL_COUNT):
        slot = find_cell(cells, p, n, level)
        if slot >= 0 and cells.sums[slot, SUM_COUNT] >= least_count and cells.sums[slot, SUM_WEIGHT] > 0.0:
            return slot, level
    return -1, LEVEL_COUNT
