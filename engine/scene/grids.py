# SPDX-License-Identifier: GPL-3.0-or-later
"""Voxels of volumes, kept where there are any: tiles of 8 x 8 x 8, 16 bits a value between the tile's own limits."""

from __future__ import annotations

import math
from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass

import numpy as np

from engine.array_types import Float32Array, Int32Array

#: Voxels along the edge of a tile, and in a tile.
TILE = 8
TILE_VOXELS = TILE**3
_LARGEST = 65535
#: Tiles that a grid's box may hold, with or without anything in them; each takes four bytes.
MOST_TILES = 2**28


@dataclass
class Grid:
    """Values in space, 0 outside of tiles; between the centres of voxels they are interpolated.

    Attributes
    ----------
    key : hashable
        Changes whenever the content does.
    to_index : float32 (4, 4)
        From the space of the object to indices of voxels, whose centres are at whole numbers.
    first : int32 (3,)
        Index of the first voxel of the first tile.
    tiles : int32 (X, Y, Z)
        Row of `voxels`, -1 = nothing is there.
    voxels : uint16 (T, TILE_VOXELS, C), the last index runs fastest; lower, step : float32 (T, C)
        A value is `lower + voxel * step`.
    """

    key: Hashable
    to_index: Float32Array
    first: Int32Array
    tiles: Int32Array
    voxels: np.ndarray
    lower: Float32Array
    step: Float32Array

    @property
    def width(self) -> int:
        """Numbers a voxel has."""
        return int(self.voxels.shape[2])

    @property
    def nbytes(self) -> int:
        """Memory that it takes."""
        return int(self.tiles.nbytes + self.voxels.nbytes + self.lower.nbytes + self.step.nbytes)


@dataclass
class VolumeMotion:
    """How what is in a volume moves while the shutter is open: by its velocity, as a semi-Lagrangian step says.

    Attributes
    ----------
    velocity : Grid
        Velocity, three components, in the space of the object.
    still : float
        Time of the shutter, which opens at 0 and closes at 1, at which everything is where its grids say.
    scale : float
        Factor on the velocity: what is at p at a time t is what the grids have at p - (t - still) scale velocity.
    """

    velocity: Grid
    still: float
    scale: float

    def displacement(self) -> tuple[np.ndarray, np.ndarray]:
        """The least and the most that anything moves along each axis, from where its grids have it: float64 (3,)."""
        values = unpack_values(self.velocity).reshape(-1, self.velocity.width).astype(np.float64)
        # Outside of the grid, and where it fades, there are all velocities down to 0.
        slowest, fastest = values.min(axis=0, initial=0.0), values.max(axis=0, initial=0.0)
        ends = self.scale * np.array([-self.still, 1.0 - self.still])
        moved = np.concatenate([ends[:, None] * slowest, ends[:, None] * fastest, np.zeros((1, len(slowest)))])
        return np.broadcast_to(moved.min(axis=0), 3).copy(), np.broadcast_to(moved.max(axis=0), 3).copy()


@dataclass(frozen=True)
class Found:
    """What was wrong with voxels: values that are no numbers, which become 0, and values below 0."""

    not_finite: int = 0
    negative: int = 0


def tile_count(first: Sequence[int], last: Sequence[int]) -> int:
    """Tiles of the box from one voxel to another, both included, whether there is anything in them or not."""
    counts = [int(b) // TILE - int(a) // TILE + 1 for a, b in zip(first, last, strict=True)]
    return math.prod(counts)


def pack_grid(
    key: Hashable, to_index: np.ndarray, first: tuple[int, ...], last: tuple[int, ...],
    read: Callable[[tuple[int, ...], tuple[int, ...]], np.ndarray],
) -> tuple[Grid, Found]:
    """Tiles of the voxels from `first` to `last`, both included.

    Parameters
    ----------
    read : callable
        Takes an index and a shape, and gives values: float (\\*shape, C). Asked for one layer of tiles at a time.
    """
    lower = np.array(first) // TILE * TILE
    counts = (np.array(last) - lower) // TILE + 1
    tiles = np.full(tuple(counts), -1, np.int32)
    voxels: list[np.ndarray] = []
    limits: list[tuple[np.ndarray, np.ndarray]] = []
    not_finite = negative = total = 0
    shape = (TILE, int(counts[1]) * TILE, int(counts[2]) * TILE)
    for layer in range(int(counts[0])):
        start = (int(lower[0]) + layer * TILE, int(lower[1]), int(lower[2]))
        values = np.asarray(read(start, shape), np.float32)
        is_finite = np.isfinite(values)
        not_finite += int(values.size - is_finite.sum())
        values = np.where(is_finite, values, np.float32(0.0))
        negative += int((values < 0.0).sum())
        width = values.shape[-1]
        blocks = values.reshape(TILE, counts[1], TILE, counts[2], TILE, width).transpose(1, 3, 0, 2, 4, 5)
        blocks = blocks.reshape(-1, TILE_VOXELS, width)
        kept = np.flatnonzero(blocks.any(axis=(1, 2)))
        blocks = blocks[kept]
        tiles[layer].reshape(-1)[kept] = np.arange(total, total + len(kept))
        total += len(kept)
        low, high = blocks.min(axis=1, initial=np.inf), blocks.max(axis=1, initial=-np.inf)
        step = ((high.astype(np.float64) - low) / _LARGEST).astype(np.float32)
        scaled = (blocks - low[:, None]) / np.where(step > 0.0, step, 1.0)[:, None]
        voxels.append(np.clip(np.rint(scaled), 0, _LARGEST).astype(np.uint16))
        limits.append((low.astype(np.float32), step))
    grid = Grid(
        key, np.ascontiguousarray(to_index, np.float32), lower.astype(np.int32), tiles, np.concatenate(voxels),
        np.concatenate([low for low, _ in limits]), np.concatenate([step for _, step in limits]),
    )
    return grid, Found(not_finite, negative)


def unpack_values(grid: Grid) -> Float32Array:
    """What the tiles hold, float32 (T, TILE_VOXELS, C)."""
    return grid.lower[:, None] + grid.voxels.astype(np.float32) * grid.step[:, None]
