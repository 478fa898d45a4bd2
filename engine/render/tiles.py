# SPDX-License-Identifier: GPL-3.0-or-later
"""A frame's region cut into square tiles, or into units that hold an even share of the pixels of larger squares. Their
pixels are worked out when they are asked for."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import overload

import numpy as np

from engine.scene.description import Frame

#: Side of a tile [pixels].
TILE_SIZE = 32

#: Pixels (column, row in the full image), int32 (N, 2), and their indices in the film, int64 (N,).
Tile = tuple[np.ndarray, np.ndarray]


@lru_cache(maxsize=8)
def _grid(row_count: int, column_count: int) -> tuple[np.ndarray, np.ndarray]:
    """Row and column of each pixel of a tile: four sizes at most are in an image."""
    rows, columns = np.divmod(np.arange(row_count * column_count, dtype=np.int64), column_count)
    return rows, columns


class FrameTiles(Sequence[Tile]):
    """Tiles of a frame's region, row by row: of an image of 8K all of them together would take half a gigabyte.

    Attributes
    ----------
    pixel_count : int, of all tiles
    largest : int, pixels of the largest tile
    """

    def __init__(self, frame: Frame) -> None:
        x0, y0, x1, y1 = self._region = frame.region
        self._columns, self._rows = -(-(x1 - x0) // TILE_SIZE), -(-(y1 - y0) // TILE_SIZE)
        self.pixel_count = (x1 - x0) * (y1 - y0)
        self.largest = min(TILE_SIZE, x1 - x0) * min(TILE_SIZE, y1 - y0)

    def __len__(self) -> int:
        return self._columns * self._rows

    @overload
    def __getitem__(self, index: int) -> Tile: ...

    @overload
    def __getitem__(self, index: slice) -> list[Tile]: ...

    def __getitem__(self, index: int | slice) -> Tile | list[Tile]:
        if isinstance(index, slice):
            return [self[i] for i in range(*index.indices(len(self)))]
        if not 0 <= index < len(self):
            raise IndexError(f"tile {index} of {len(self)}")
        x0, y0, x1, y1 = self._region
        row, column = divmod(index, self._columns)
        left, top = x0 + column * TILE_SIZE, y0 + row * TILE_SIZE
        width = x1 - x0
        rows, columns = _grid(min(TILE_SIZE, y1 - top), min(TILE_SIZE, x1 - left))
        pixels = np.empty((len(rows), 2), np.int32)
        np.add(columns, left, out=pixels[:, 0])
        np.add(rows, top, out=pixels[:, 1])
        return pixels, rows * width + (columns + ((top - y0) * width + left - x0))


#: Of `TrialTiles`: units of a square of so many tiles by as many, side of the blocks of which each unit has one quarter
#: [pixels], and bits of a coordinate that are within a quarter.
_UNITS = 4
_GROUP_SIDE = 2
_BLOCK_SIZE = 8
_QUARTER_BITS = 2


def _piece(columns: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """Which of the units pixels belong to, by column and row in the region: int64.

    Each unit has one quarter of each block. Which one is told by a hash, so that no pattern of the scene can be that of
    a unit.
    """
    quarter = (columns >> _QUARTER_BITS & 1) + 2 * (rows >> _QUARTER_BITS & 1)
    block = (columns // _BLOCK_SIZE * 0x9E3779B1 ^ rows // _BLOCK_SIZE * 0x85EBCA77) & 0xFFFFFFFF
    block = (block ^ block >> 15) * 0x2C1B3C6D & 0xFFFFFFFF
    return quarter + (block ^ block >> 12) & _UNITS - 1


class TrialTiles(Sequence[Tile]):
    """The pixels of `FrameTiles` in other units: the first have an even quarter of them, on which something is tried.

    A unit has as many pixels as a tile at most; at the border some may have none.

    Attributes
    ----------
    trial_count : int, units of the trial, which come first
    trial_pixels : int, of these
    """

    def __init__(self, frame: Frame) -> None:
        x0, y0, x1, y1 = self._region = frame.region
        side = _GROUP_SIDE * TILE_SIZE
        self._columns = -(-(x1 - x0) // side)
        self.trial_count = self._columns * -(-(y1 - y0) // side)
        rows = np.arange(y1 - y0, dtype=np.int64)
        columns = np.arange(x1 - x0, dtype=np.int64)
        self.trial_pixels = sum(int((_piece(columns, row) == 0).sum()) for row in rows)

    def __len__(self) -> int:
        return _UNITS * self.trial_count

    @overload
    def __getitem__(self, index: int) -> Tile: ...

    @overload
    def __getitem__(self, index: slice) -> list[Tile]: ...

    def __getitem__(self, index: int | slice) -> Tile | list[Tile]:
        if isinstance(index, slice):
            return [self[i] for i in range(*index.indices(len(self)))]
        if not 0 <= index < len(self):
            raise IndexError(f"unit {index} of {len(self)}")
        group, piece = index, 0
        if index >= self.trial_count:
            group, piece = divmod(index - self.trial_count, _UNITS - 1)
            piece += 1
        x0, y0, x1, y1 = self._region
        side = _GROUP_SIDE * TILE_SIZE
        row, column = divmod(group, self._columns)
        left, top = side * column, side * row
        rows, columns = _grid(min(side, y1 - y0 - top), min(side, x1 - x0 - left))
        rows, columns = rows + top, columns + left
        chosen = _piece(columns, rows) == piece
        rows, columns = rows[chosen], columns[chosen]
        pixels = np.empty((len(rows), 2), np.int32)
        np.add(columns, x0, out=pixels[:, 0])
        np.add(rows, y0, out=pixels[:, 1])
        return pixels, rows * (x1 - x0) + columns
