# SPDX-License-Identifier: GPL-3.0-or-later
"""`CellField`: mean radiance that surfaces send back, by cell, in a hash table of several cell sizes.

Direction and shader make a cell (`hash_grid`): so the two sides of a thin wall, the walls of a corner, and things of
different colours are apart. Each size is twice the next smaller one.
"""

from typing import Any

import numpy as np

from engine.array_types import Float32Array, Uint32Array
from engine.guiding.fields.hash_grid import claim_place, find_place, grid_cell
from engine.kernels.rng import hash_combine
from engine.runtime.bundle import Bundle
from engine.runtime.jit import kernel
from engine.state.columns import aligned_bytes

#: Sizes of cells: the largest is 2^(LEVEL_COUNT - 1) times the smallest.
LEVEL_COUNT = 6
#: Places of the table, a power of two, and how many of them a cell may be in.
SLOT_COUNT = 1 << 20
_PROBE_COUNT = 8

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

    def __reduce__(self) -> Any:
        used = np.flatnonzero(self.tag)
        return _with_cells, (float(self.size[0]), len(self.tag), used, self.tag[used], self.sums[used])


def empty_cells(size: float = 1.0, slot_count: int = SLOT_COUNT) -> CellField:
    """A field that knows nothing, with room for so many cells, the smallest of this size [m]."""
    places = aligned_bytes(slot_count * _PLACE_WIDTH * 4).view(np.float32).reshape(slot_count, _PLACE_WIDTH)
    return CellField(
        places.view(np.uint32)[:, SUM_WIDTH], places[:, :SUM_WIDTH], np.full(1, size, np.float32),
        np.full(1, slot_count - 1, np.uint32),
    )


def _places(cells: CellField) -> Float32Array:
    """Sums and tags, float32 (S, _PLACE_WIDTH): they lie together, and are copied faster so."""
    return np.lib.stride_tricks.as_strided(cells.sums, (len(cells.tag), _PLACE_WIDTH), cells.sums.strides)


def copy_cells(cells: CellField, other: CellField) -> None:
    """Have another field of as many places know what one does."""
    _places(other)[:] = _places(cells)


def _with_cells(size: float, slot_count: int, used: np.ndarray, tag: np.ndarray, sums: np.ndarray) -> CellField:
    """A field from another process: strides are a part of its type, so it is made here."""
    cells = empty_cells(size, slot_count)
    cells.tag[used], cells.sums[used] = tag, sums
    return cells


def no_cells() -> CellField:
    """A field of which nothing is asked."""
    return empty_cells(slot_count=1)


@kernel
def cell_size(cells, level):
    """Side of the cells of a level [m], float32."""
    return cells.size[0] * np.float32(1 << level)


@kernel
def cell_key(cells, p, n, program, level):
    """First place, and tag (not 0), of the cell of a level at p on the side that n faces: int, uint32.

    Parameters
    ----------
    p : tuple of 3 float32, world [m]; n : tuple of 3 float32, unit
    program : int, of the surface's shader
    """
    inverse = np.float32(1.0) / cell_size(cells, level)
    x, y, z, kind = grid_cell(p, n, program * LEVEL_COUNT + level, inverse)
    first, second = hash_combine(x, y), hash_combine(z, kind)
    key, tag = hash_combine(first, second), hash_combine(second, first)
    return np.int64(key & cells.mask[0]), max(tag, np.uint32(1))


@kernel
def find_cell(cells, place, tag):
    """Where in the table a cell is (`cell_key`), -1 where there is none."""
    return find_place(cells, place, tag, _PROBE_COUNT)


@kernel
def claim_cell(cells, place, tag):
    """Where in the table a cell is, made if there is none; -1 where the table has no room near."""
    return claim_place(cells, place, tag, _PROBE_COUNT)
