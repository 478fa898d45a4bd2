# SPDX-License-Identifier: GPL-3.0-or-later
"""How a frame is divided into tiles."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from engine.render.adaptive import Tile
from engine.scene.description import Frame

#: Side of a tile [pixels].
TILE_SIZE = 32


@lru_cache(maxsize=8)
def _grid(row_count: int, column_count: int) -> tuple[np.ndarray, np.ndarray]:
    """Row and column of each pixel of a tile: four sizes at most are in an image, and a render starts at once."""
    rows, columns = np.divmod(np.arange(row_count * column_count, dtype=np.int64), column_count)
    return rows, columns


def tiles_of(frame: Frame) -> list[Tile]:
    """Pixels (column, row in the full image) and film indices of each tile of the region."""
    x0, y0, x1, y1 = frame.region
    width = x1 - x0
    tiles = []
    for top in range(y0, y1, TILE_SIZE):
        for left in range(x0, x1, TILE_SIZE):
            rows, columns = _grid(min(TILE_SIZE, y1 - top), min(TILE_SIZE, x1 - left))
            pixels = np.empty((len(rows), 2), np.int32)
            np.add(columns, left, out=pixels[:, 0])
            np.add(rows, top, out=pixels[:, 1])
            tiles.append((pixels, rows * width + (columns + ((top - y0) * width + left - x0))))
    return tiles
