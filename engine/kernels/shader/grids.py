# SPDX-License-Identifier: GPL-3.0-or-later
"""What a grid of voxels holds at a point, between the centres of eight of them, or by a cubic spline of 64."""

import numpy as np

from engine.kernels.eight import absolute, choose, counted_from, larger, sum_of, words_apart, words_from
from engine.kernels.motion import direction_to_world, point_to_object
from engine.kernels.rounding import floor_of
from engine.kernels.vector import add, scale, transform_point
from engine.runtime.jit import kernel
from engine.state.geometry import INSTANCE_MESH
from engine.state.grids import (
    GRID_COMPONENTS,
    GRID_FIRST,
    GRID_FIRST_RANGE,
    GRID_FIRST_TILE,
    GRID_FIRST_VOXEL,
    GRID_TILES,
)

# Side of a tile of 8 x 8 x 8 voxels.
_TILE = 8
_TILE_BITS = 3
_WITHIN_TILE = 7
_TILE_VOXELS = 512


@kernel
def _find_voxel(grids, grid, i, j, k):
    """Where a voxel lies, counted from the grid's first one.

    Returns
    -------
    at : int64
        Place of its first component in `grids.voxels`; -1 where there is nothing.
    row : int64
        Row of that component's limits in `grids.ranges`.
    """
    table = grids.table
    x, y, z = i >> _TILE_BITS, j >> _TILE_BITS, k >> _TILE_BITS
    ny, nz = table[grid, GRID_TILES + 1], table[grid, GRID_TILES + 2]
    if x < 0 or y < 0 or z < 0 or x >= table[grid, GRID_TILES] or y >= ny or z >= nz:
        return np.int64(-1), np.int64(0)
    tile = np.int64(grids.tiles[table[grid, GRID_FIRST_TILE] + (x * ny + y) * nz + z])
    if tile < 0:
        return np.int64(-1), np.int64(0)
    count = table[grid, GRID_COMPONENTS]
    within = ((i & _WITHIN_TILE) << (2 * _TILE_BITS)) + ((j & _WITHIN_TILE) << _TILE_BITS) + (k & _WITHIN_TILE)
    at = table[grid, GRID_FIRST_VOXEL] + (tile * _TILE_VOXELS + within) * count
    return np.int64(at), np.int64(table[grid, GRID_FIRST_RANGE] + tile * count)


@kernel
def _component(grids, at, row):
    """A component of a voxel that there is."""
    return grids.ranges[row, 0] + np.float32(grids.voxels[at]) * grids.ranges[row, 1]


@kernel
def _alpha(grids, grid, i, j, k):
    """The fourth component of a voxel, of a grid that has four."""
    at, row = _find_voxel(grids, grid, i, j, k)
    return _component(grids, at + 3, row + 3) if at >= 0 else 0.0


@kernel
def _voxel(grids, grid, i, j, k):
    """Three components of a voxel, counted from the grid's first one: those that there are not repeat a single one."""
    at, row = _find_voxel(grids, grid, i, j, k)
    if at < 0:
        return 0.0, 0.0, 0.0
    first = _component(grids, at, row)
    if grids.table[grid, GRID_COMPONENTS] < 3:
        return first, first, first
    return first, _component(grids, at + 1, row + 1), _component(grids, at + 2, row + 2)


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
    at, row = _find_voxel(grids, grid, i, j, k)
    if at < 0:
        return 0.0, 0.0, 0.0
    count, ranges = grids.table[grid, GRID_COMPONENTS], grids.ranges
    x = _between(grids, at, count, ranges[row, 0], ranges[row, 1], ux, uy, uz)
    if count < 3:
        return x, x, x
    y = _between(grids, at + 1, count, ranges[row + 1, 0], ranges[row + 1, 1], ux, uy, uz)
    z = _between(grids, at + 2, count, ranges[row + 2, 0], ranges[row + 2, 1], ux, uy, uz)
    return x, y, z


@kernel
def _spline(distance):
    """Weight of a voxel in a cubic B-spline, by its distance along an axis [voxels]; eight of them or one."""
    rest = larger(2.0 - distance, 0.0)
    return choose(
        distance <= 1.0, distance * distance * (0.5 * distance - 1.0) + 2.0 / 3.0, rest * rest * rest * (1.0 / 6.0)
    )


@kernel
def _smooth(grids, grid, component, i, j, k, ux, uy, uz):
    """A component by a cubic spline, between a voxel and the next ones.

    The 64 voxels lie in one to eight tiles; of each a whole row along z is read at once.
    """
    count = grids.table[grid, GRID_COMPONENTS]
    total = counted_from(0.0) * 0.0
    for corner in range(8):
        x0 = (((i - 1) >> _TILE_BITS) + (corner >> 2)) << _TILE_BITS
        y0 = (((j - 1) >> _TILE_BITS) + ((corner >> 1) & 1)) << _TILE_BITS
        z0 = (((k - 1) >> _TILE_BITS) + (corner & 1)) << _TILE_BITS
        if x0 > i + 2 or y0 > j + 2 or z0 > k + 2:
            continue
        first, row = _find_voxel(grids, grid, x0, y0, z0)
        if first < 0:
            continue
        whole = 0.0
        voxels = counted_from(0.0) * 0.0
        for x in range(max(i - 1, x0), min(i + 3, x0 + _TILE)):
            along_x = _spline(abs(np.float32(x - i) - ux))
            for y in range(max(j - 1, y0), min(j + 3, y0 + _TILE)):
                weight = along_x * _spline(abs(np.float32(y - j) - uy))
                at = first + (((x - x0) << (2 * _TILE_BITS)) + ((y - y0) << _TILE_BITS)) * count + component
                if count == 1:
                    voxels = voxels + words_from(grids.voxels, at) * weight
                else:
                    voxels = voxels + words_apart(grids.voxels, at, count) * weight
                whole += weight
        along_z = _spline(absolute(counted_from(np.float32(z0 - k) - uz)))
        lowest, step = grids.ranges[row + component, 0], grids.ranges[row + component, 1]
        total = total + along_z * (voxels * step + lowest * whole)
    return sum_of(total)


@kernel
def _smooth_values(grids, grid, i, j, k, ux, uy, uz):
    """What `sample_grid` returns by cubic splines."""
    x, y, z = 0.0, 0.0, 0.0
    count = min(grids.table[grid, GRID_COMPONENTS], 3)
    for component in range(count):
        value = _smooth(grids, grid, component, i, j, k, ux, uy, uz)
        if component == 0:
            x = value
        elif component == 1:
            y = value
        else:
            z = value
    if count < 3:
        return x, x, x
    return x, y, z


@kernel
def _voxel_before(grids, grid, p):
    """The voxel whose centre comes before a point in the space of the object, along each axis.

    Returns
    -------
    is_near : bool
        Whether its numbers can be counted.
    i, j, k : int64
        From the grid's first one.
    ux, uy, uz : float32 in [0, 1]
        How far the point is on the way to the next.
    """
    index = transform_point(grids.to_index, grid, p)
    fx, fy, fz = floor_of(index[0]), floor_of(index[1]), floor_of(index[2])
    ux, uy, uz = index[0] - fx, index[1] - fy, index[2] - fz
    if not abs(fx) + abs(fy) + abs(fz) < 1e9:
        return False, np.int64(0), np.int64(0), np.int64(0), ux, uy, uz
    i = np.int64(fx) - np.int64(grids.table[grid, GRID_FIRST])
    j = np.int64(fy) - np.int64(grids.table[grid, GRID_FIRST + 1])
    k = np.int64(fz) - np.int64(grids.table[grid, GRID_FIRST + 2])
    return True, i, j, k, ux, uy, uz


@kernel
def sample_alpha(grids, grid, p, is_smooth):
    """Alpha of a grid of colours at a point in the space of its object, 1 of a grid that has none."""
    if grids.table[grid, GRID_COMPONENTS] < 4:
        return 1.0 + 0.0 * p[0]
    is_near, i, j, k, ux, uy, uz = _voxel_before(grids, grid, p)
    if not is_near:
        return 0.0
    if is_smooth:
        return _smooth(grids, grid, 3, i, j, k, ux, uy, uz)
    total = 0.0
    for corner in range(8):
        a, b, c = corner >> 2, (corner >> 1) & 1, corner & 1
        weight = (ux if a else 1.0 - ux) * (uy if b else 1.0 - uy) * (uz if c else 1.0 - uz)
        total += weight * _alpha(grids, grid, i + a, j + b, k + c)
    return total


@kernel
def sample_grid(grids, grid, p, is_smooth):
    """Values of a grid at a point in the space of its object: three components, equal ones if it has one alone.

    Parameters
    ----------
    is_smooth : bool
        By cubic splines, not by straight lines.
    """
    is_near, i, j, k, ux, uy, uz = _voxel_before(grids, grid, p)
    if not is_near:
        return 0.0, 0.0, 0.0
    if is_smooth:
        return _smooth_values(grids, grid, i, j, k, ux, uy, uz)
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


@kernel
def moved_point(geometry, instance, time, p):
    """Where the grids of a volume have what is at a point of the world at a time: two steps back by its velocity.

    References
    ----------
    Kim and Ko 2007, "Eulerian Motion Blur"; Wrenninge 2012, "Production Volume Rendering", section 11.2.
    """
    grids, mesh = geometry.grids, geometry.instance_table[instance, INSTANCE_MESH]
    grid = grids.velocity[mesh]
    if grid < 0:
        return p
    step = -(time - grids.motion[mesh, 0]) * grids.motion[mesh, 1]
    local = point_to_object(geometry, instance, time, p)
    velocity = sample_grid(grids, grid, local, False)
    velocity = sample_grid(grids, grid, add(local, scale(velocity, step)), False)
    return add(p, direction_to_world(geometry, instance, time, scale(velocity, step)))
