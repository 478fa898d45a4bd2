# SPDX-License-Identifier: GPL-3.0-or-later
"""Grids of meshes, laid one after the other."""

from __future__ import annotations

from collections.abc import Collection, Sequence

import numpy as np

from engine.scene.description import Mesh
from engine.scene.grids import TILE_VOXELS, Grid
from engine.state.grids import GRID_TABLE_WIDTH, GridArrays, no_grids


def build_grids(meshes: Sequence[Mesh], names: Collection[str]) -> tuple[GridArrays, dict[tuple[int, str], int]]:
    """Arrays of the grids that programs ask for.

    Parameters
    ----------
    names : collection of str
        Attributes that programs read.

    Returns
    -------
    GridArrays
    numbers : dict
        Row of the table, by index of the mesh and name. Meshes that share a grid share the row.
    """
    numbers: dict[tuple[int, str], int] = {}
    grids: list[Grid] = []
    known: dict[int, int] = {}

    def number_of(grid: Grid) -> int:
        if id(grid) not in known:
            known[id(grid)] = len(grids)
            grids.append(grid)
        return known[id(grid)]

    velocity = np.full(max(len(meshes), 1), -1, np.int32)
    motion = np.zeros((max(len(meshes), 1), 2), np.float32)
    for index, mesh in enumerate(meshes):
        numbers.update({(index, name): number_of(grid) for name, grid in mesh.grids.items() if name in names})
        if mesh.volume_motion is not None:
            velocity[index] = number_of(mesh.volume_motion.velocity)
            motion[index] = mesh.volume_motion.still, mesh.volume_motion.scale
    if not grids:
        return no_grids(len(meshes)), numbers
    table = np.zeros((len(grids), GRID_TABLE_WIDTH), np.int64)
    first_tile = first_voxel = first_range = 0
    for row, grid in enumerate(grids):
        table[row] = (grid.width, *grid.first, *grid.tiles.shape, first_tile, first_voxel, first_range)
        first_tile += grid.tiles.size
        first_voxel += grid.voxels.size
        first_range += grid.lower.size
    arrays = GridArrays(
        table=table,
        to_index=np.stack([grid.to_index[:3].reshape(12) for grid in grids]).astype(np.float32),
        tiles=np.concatenate([grid.tiles.ravel() for grid in grids]),
        voxels=np.concatenate([grid.voxels.ravel() for grid in grids] + [np.zeros(TILE_VOXELS, np.uint16)]),
        ranges=np.concatenate(
            [np.stack([grid.lower.ravel(), grid.step.ravel()], axis=1) for grid in grids]
            + [np.zeros((1, 2), np.float32)]
        ),
        velocity=velocity,
        motion=motion,
    )
    return arrays, numbers
