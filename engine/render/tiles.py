# SPDX-License-Identifier: GPL-3.0-or-later
"""A frame's region cut into square tiles, whose pixels are worked out when they are asked for."""

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
