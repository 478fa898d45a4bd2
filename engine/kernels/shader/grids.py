# SPDX-License-Identifier: GPL-3.0-or-later
"""What a grid of voxels holds at a point, between the centres of eight of them."""


import numpy as np

from engine.kernels.rounding import floor_of
from engine.kernels.vector import transform_point
from engine.runtime.jit import kernel
from engine.state.grids import (
    GRID_COMPONENTS,
    GRID_FIRST,
    GRID_FIRST_RANGE,
    GRID_FIRST_TILE,
    GRID_FIRST_VOXEL,
    GRID_TILES,
)

# Of a tile of 8 x 8 x 8 voxels.
_TILE_BITS = 3
_WITHIN_TILE = 7
_TILE_VOXELS = 512


@kernel
def _voxel(grids, grid, i, j, k):
    """Three components of a voxel, counted from the grid's first one: those that there are not repeat a single one."""
    table = grids.table
    x, y, z = i >> _TILE_BITS, j >> _TILE_BITS, k >> _TILE_BITS
    ny, nz = table[grid, GRID_TILES + 1], table[grid, GRID_TILES + 2]
    if x < 0 or y < 0 or z < 0 or x >= table[grid, GRID_TILES] or y >= ny or z >= nz:
        return 0.0, 0.0, 0.0
    tile = np.int64(grids.tiles[table[grid, GRID_FIRST_TILE] + (x * ny + y) * nz + z])
    if tile < 0:
        return 0.0, 0.0, 0.0
    count = table[grid, GRID_COMPONENTS]
    within = ((i & _WITHIN_TILE) << (2 * _TILE_BITS)) + ((j & _WITHIN_TILE) << _TILE_BITS) + (k & _WITHIN_TILE)
    at = table[grid, GRID_FIRST_VOXEL] + (tile * _TILE_VOXELS + within) * count
    row = table[grid, GRID_FIRST_RANGE] + tile * count
    first = grids.ranges[row, 0] + np.float32(grids.voxels[at]) * grids.ranges[row, 1]
    if count < 3:
        return first, first, first
    second = grids.ranges[row + 1, 0] + np.float32(grids.voxels[at + 1]) * grids.ranges[row + 1, 1]
    third = grids.ranges[row + 2, 0] + np.float32(grids.voxels[at + 2]) * grids.ranges[row + 2, 1]
    return first, second, third


@kernel
def _is_within(grids, grid, i, j, k):
    """Whether a voxel and those that follow it along each axis lie in one tile of the grid."""
    table = grids.table
    is_inner = (i & _WITHIN_TILE) != _WITHIN_TILE and (j & _WITHIN_TILE) != _WITHIN_TILE
    is_inner = is_inner and (k & _WITHIN_TILE) != _WITHIN_TILE and i >= 0 and j >= 0 and k >= 0
    return (
        is_inner and (i >> _TILE_BITS) < table[grid, GRID_TILES] and (j >> _TILE_BITS) < table[grid, GRID_TILES + 1]
        and (k >> _TILE_BITS) < table[grid, GRID_TILES + 2]
    )


@kernel
def _between(grids, first, count, lowest, step, ux, uy, uz):
    """A component between eight voxels of a tile, from `first` on; a voxel has `count` numbers."""
    total = 0.0
    for corner in range(8):
        a, b, c = corner >> 2, (corner >> 1) & 1, corner & 1
        weight = (ux if a else 1.0 - ux) * (uy if b else 1.0 - uy) * (uz if c else 1.0 - uz)
        at = first + ((a << (2 * _TILE_BITS)) + (b << _TILE_BITS) + c) * count
        total += weight * (lowest + np.float32(grids.voxels[at]) * step)
    return total


@kernel
def _sample_tile(grids, grid, i, j, k, ux, uy, uz):
    """What `sample_grid` returns where all eight voxels are of one tile."""
    table, ranges = grids.table, grids.ranges
    ny, nz = table[grid, GRID_TILES + 1], table[grid, GRID_TILES + 2]
    place = ((i >> _TILE_BITS) * ny + (j >> _TILE_BITS)) * nz + (k >> _TILE_BITS)
    tile = np.int64(grids.tiles[table[grid, GRID_FIRST_TILE] + place])
    if tile < 0:
        return 0.0, 0.0, 0.0
    count = table[grid, GRID_COMPONENTS]
    within = ((i & _WITHIN_TILE) << (2 * _TILE_BITS)) + ((j & _WITHIN_TILE) << _TILE_BITS) + (k & _WITHIN_TILE)
    at = table[grid, GRID_FIRST_VOXEL] + (tile * _TILE_VOXELS + within) * count
    row = table[grid, GRID_FIRST_RANGE] + tile * count
    x = _between(grids, at, count, ranges[row, 0], ranges[row, 1], ux, uy, uz)
    if count < 3:
        return x, x, x
    y = _between(grids, at + 1, count, ranges[row + 1, 0], ranges[row + 1, 1], ux, uy, uz)
    z = _between(grids, at + 2, count, ranges[row + 2, 0], ranges[row + 2, 1], ux, uy, uz)
    return x, y, z


@kernel
def sample_grid(grids, grid, p):
    """Values of a grid at a point in the space of its object: three components, equal ones if it has one alone."""
    index = transform_point(grids.to_index, grid, p)
    fx, fy, fz = floor_of(index[0]), floor_of(index[1]), floor_of(index[2])
    if not abs(fx) + abs(fy) + abs(fz) < 1e9:
        return 0.0, 0.0, 0.0
    ux, uy, uz = index[0] - fx, index[1] - fy, index[2] - fz
    i = np.int64(fx) - grids.table[grid, GRID_FIRST]
    j = np.int64(fy) - grids.table[grid, GRID_FIRST + 1]
    k = np.int64(fz) - grids.table[grid, GRID_FIRST + 2]
    if _is_within(grids, grid, i, j, k):
        return _sample_tile(grids, grid, i, j, k, ux, uy, uz)
    x, y, z = 0.0, 0.0, 0.0
    for corner in range(8):
        a, b, c = corner >> 2, (corner >> 1) & 1, corner & 1
        weight = (ux if a else 1.0 - ux) * (uy if b else 1.0 - uy) * (uz if c else 1.0 - uz)
        value = _voxel(grids, grid, i + a, j + b, k + c)
        x += weight * value[0]
        y += weight * value[1]
        z += weight * value[2]
    return x, y, z
