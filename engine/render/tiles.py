# SPDX-License-Identifier: GPL-3.0-or-later
"""A frame's region cut into square tiles, or into units that hold an even share of the pixels of larger squares. Their
pixels are worked out when they are asked for."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from functools import lru_cache
from typing import overload

import numpy as np

from engine.scene.description import Frame

#: Side of a tile [pixels].
TILE_SIZE = 32
#: A frame of up to so many pixels keeps its tiles, 16 bytes a pixel: each is asked for once a task.
_KEPT_PIXELS = 1 << 20

#: Pixels (column, row in the full image), int32 (N, 2), and their indices in the film, int64 (N,).
Tile = tuple[np.ndarray, np.ndarray]


@lru_cache(maxsize=8)
def _grid(row_count: int, column_count: int) -> tuple[np.ndarray, np.ndarray]:
    """Row and column of each pixel of a tile: four sizes at most are in an image."""
    rows, columns = np.divmod(np.arange(row_count * column_count, dtype=np.int64), column_count)
    return rows, columns


class _Tiles(Sequence[Tile], ABC):
    """Tiles that are worked out one by one."""

    @abstractmethod
    def _tile(self, index: int) -> Tile:
        """The tile of an index that there is."""

    @overload
    def __getitem__(self, index: int) -> Tile: ...

    @overload
    def __getitem__(self, index: slice) -> list[Tile]: ...

    def __getitem__(self, index: int | slice) -> Tile | list[Tile]:
        if isinstance(index, slice):
            return [self[i] for i in range(*index.indices(len(self)))]
        if not 0 <= index < len(self):
            raise IndexError(f"tile {index} of {len(self)}")
        return self._tile(index)


class FrameTiles(_Tiles):
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
        self._kept: dict[int, Tile] = {}

    def __len__(self) -> int:
        return self._columns * self._rows

    def _tile(self, index: int) -> Tile:
        if self.pixel_count > _KEPT_PIXELS:
            return self._made(index)
        if index not in self._kept:
            self._kept[index] = self._made(index)
        return self._kept[index]

    def _made(self, index: int) -> Tile:
        x0, y0, x1, y1 = self._region
        row, column = divmod(index, self._columns)
        left, top = x0 + column * TILE_SIZE, y0 + row * TILE_SIZE
        width = x1 - x0
        rows, columns = _grid(min(TILE_SIZE, y1 - top), min(TILE_SIZE, x1 - left))
        pixels = np.empty((len(rows), 2), np.int32)
        np.add(columns, left, out=pixels[:, 0])
        np.add(rows, top, out=pixels[:, 1])
        return pixels, rows * width + (columns + ((top - y0) * width + left - x0))


#: Side of the squares that so many units share, each with one pixel of every quad of 2 x 2 [pixels].
_GROUP_SIZE = 2 * TILE_SIZE
_UNITS = 4


def _turn(columns: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """A hash of each quad, of columns and rows of quads in the region, that says which pixel is whose: int64.

    No pattern of the scene can then be that of a unit.
    """
    turn = (columns * 0x9E3779B1 ^ rows * 0x85EBCA77) & 0xFFFFFFFF
    turn = (turn ^ turn >> 15) * 0x2C1B3C6D & 0xFFFFFFFF
    return turn ^ turn >> 12


class TrialTiles(_Tiles):
    """The pixels of `FrameTiles` in other units: the first have an even quarter of them, on which something is tried.

    A unit has as many pixels as a tile at most; at the border some may have none. Pixels that are tried lie among the
    others one by one: a denoiser takes patches with another noise than that around them for what is in the picture
    (docs/decisions/trial-and-choice.md).

    Attributes
    ----------
    trial_count : int, units of the trial, which come first
    trial_pixels : int, of these
    """

    def __init__(self, frame: Frame) -> None:
        x0, y0, x1, y1 = self._region = frame.region
        self._columns = -(-(x1 - x0) // _GROUP_SIZE)
        self.trial_count = self._columns * -(-(y1 - y0) // _GROUP_SIZE)
        width, height = x1 - x0, y1 - y0
        # The border cuts some quads: part of their pixels lie outside.
        cut = [
            self._places(np.arange(-(-height // 2)), np.full(-(-height // 2), width // 2), 0),
            self._places(np.full(width // 2, height // 2), np.arange(width // 2), 0),
        ]
        self.trial_pixels = (width // 2) * (height // 2) + sum(
            int(np.count_nonzero((rows < height) & (columns < width))) for rows, columns in cut
        )

    def __len__(self) -> int:
        return _UNITS * self.trial_count

    @staticmethod
    def _places(quad_rows: np.ndarray, quad_columns: np.ndarray, unit: int) -> tuple[np.ndarray, np.ndarray]:
        """Row and column in the region of the pixel that a unit has of each quad."""
        place = unit - _turn(quad_columns, quad_rows) & _UNITS - 1
        return 2 * quad_rows + place // 2, 2 * quad_columns + place % 2

    def _tile(self, index: int) -> Tile:
        group, unit = index, 0
        if index >= self.trial_count:
            group, unit = divmod(index - self.trial_count, _UNITS - 1)
            unit += 1
        x0, y0, x1, y1 = self._region
        group_row, group_column = divmod(group, self._columns)
        quad_rows, quad_columns = _grid(_GROUP_SIZE // 2, _GROUP_SIZE // 2)
        rows, columns = self._places(
            quad_rows + _GROUP_SIZE // 2 * group_row, quad_columns + _GROUP_SIZE // 2 * group_column, unit
        )
        is_inside = (rows < y1 - y0) & (columns < x1 - x0)
        if not is_inside.all():
            rows, columns = rows[is_inside], columns[is_inside]
        pixels = np.empty((len(rows), 2), np.int32)
        np.add(columns, x0, out=pixels[:, 0])
        np.add(rows, y0, out=pixels[:, 1])
        return pixels, rows * (x1 - x0) + columns
