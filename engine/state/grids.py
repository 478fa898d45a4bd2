# SPDX-License-Identifier: GPL-3.0-or-later
"""Voxels of volumes as kernels read them (`engine.scene.grids.Grid`)."""

from __future__ import annotations

import numpy as np

from engine.array_types import Float32Array, Int32Array, Int64Array
from engine.runtime.bundle import Bundle

# Columns of GridArrays.table.
GRID_COMPONENTS = 0
GRID_FIRST = 1  # index of the first voxel, along x, y and z
GRID_TILES = 4  # along x, y and z
GRID_FIRST_TILE = 7  # of `tiles`
GRID_FIRST_VOXEL = 8  # of `voxels`
GRID_FIRST_RANGE = 9  # of `ranges`
GRID_TABLE_WIDTH = 10


class GridArrays(Bundle):
    """All grids of a scene.

    table : int64 (G, GRID_TABLE_WIDTH)
    to_index : float32 (G, 12), from the space of the object to indices of voxels
    tiles : int32, of each grid a number for each place of a tile, z runs fastest; -1 = nothing is there
    voxels : uint16, of each tile 512 voxels, z runs fastest, a voxel's components side by side
    ranges : float32 (R, 2), of each tile's components the lowest value, and the step of its voxels
    velocity : int32 (M,), by mesh the grid of how fast what is in it moves while the shutter is open, -1 = it stands
        still
    motion : float32 (M, 2), by mesh the time of the shutter at which everything is where its grids say, and a factor on
        velocities
    """

    table: Int64Array
    to_index: Float32Array
    tiles: Int32Array
    voxels: np.ndarray
    ranges: Float32Array
    velocity: Int32Array
    motion: Float32Array


def no_grids(mesh_count: int = 1) -> GridArrays:
    """`GridArrays` of so many meshes, none of which has any."""
    return GridArrays(
        table=np.zeros((1, GRID_TABLE_WIDTH), np.int64), to_index=np.zeros((1, 12), np.float32),
        tiles=np.full(1, -1, np.int32), voxels=np.zeros(1, np.uint16), ranges=np.zeros((1, 2), np.float32),
        velocity=np.full(max(mesh_count, 1), -1, np.int32), motion=np.zeros((max(mesh_count, 1), 2), np.float32),
    )
