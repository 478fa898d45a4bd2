# SPDX-License-Identifier: GPL-3.0-or-later
"""Media that vary in space: bounds on what they are anywhere, and by lane how far a ray has been followed in them."""

from __future__ import annotations

import numpy as np

from engine.array_types import Float32Array, Int32Array, Int64Array, Uint8Array
from engine.runtime.bundle import Bundle
from engine.state.columns import allocate, column

# Columns of MajorantGrids.table.
GRID_MEDIUM = 0
GRID_RESOLUTION = 1  # cells along x, y and z
GRID_WIDTH = 4

# Columns of MajorantGrids.space, in the space of the object.
GRID_LOWER = 0  # corner
GRID_SCALE = 3  # cells a metre
SPACE_WIDTH = 6


#: The world's grid: half its edge [m], as in Cycles; its cells are even in asinh(x / WORLD_UNIT), up to WORLD_REACH.
WORLD_SIZE = 10_000.0
WORLD_UNIT = np.float32(2.0)
WORLD_REACH = np.float32(np.arcsinh(WORLD_SIZE / 2.0))


class MajorantGrids(Bundle):
    """Bounds of the extinction of media that vary, by cell of a grid over what they are in.

    first : int32 (I + 2,), rows of `table` that belong to instance i are first[i + 1] to first[i + 2]; the world has
        those before
    table : int32 (G, GRID_WIDTH)
    offset : int64 (G,), first cell in `values`, x runs fastest
    space : float32 (G, SPACE_WIDTH)
    values : float32 (K,)  [m^-1], above 0 wherever there is emission as well
    """

    first: Int32Array
    table: Int32Array
    offset: Int64Array
    space: Float32Array
    values: Float32Array


def no_majorants(instance_count: int) -> MajorantGrids:
    """`MajorantGrids` where nothing varies."""
    return MajorantGrids(
        first=np.zeros(instance_count + 2, np.int32), table=np.zeros((1, GRID_WIDTH), np.int32),
        offset=np.zeros(1, np.int64), space=np.zeros((1, SPACE_WIDTH), np.float32), values=np.zeros(1, np.float32),
    )


class TrackedLanes(Bundle):
    """Rays that are followed through media that vary: a row for each path, then one for each shadow ray."""

    is_tracked: Uint8Array = column("whether the path's ray is followed at all in this round", "R")
    position: Float32Array = column("how far the ray has come along itself [m]", "R")
    end: Float32Array = column("where the surface is [m]", "R")
    weight: Float32Array = column("of what is left of the light along the ray", "R", "C")
    emitted: Float32Array = column("what the media on the way have emitted, seen from the ray's start", "R", "C")
    chosen: Int32Array = column(
        "entry of the row's media that may collide at `position`; of a shadow ray boundaries that may lie behind the "
        "next one", "R",
    )
    majorant: Float32Array = column("of what may collide [m^-1]", "R")
    collision: Float32Array = column("where the path is scattered, -1: nowhere [m]", "R")
    step: Int32Array = column("possible collisions so far", "R")
    u_event: Float32Array = column("random number that decides on a collision at `position`", "R")
    u_roulette: Float32Array = column("likewise", "R")
    lamp: Int32Array = column("lamp on the ray whose light is seen, -1 = none", "R")
    lamp_count: Int32Array = column("of how many it was picked", "R")
    lamp_distance: Float32Array = column("to it [m]", "R")
    lamp_weight: Float32Array = column("`weight` there", "R", "C")
    origin: Float32Array = column("of a shadow ray, from the boundary on that it has crossed last", "R", 3)
    rest: Float32Array = column("of that ray [m]", "R")
    instance: Int32Array = column("of the next boundary, -1 = none", "R")
    triangle: Int32Array = column("of the next boundary", "R")
    u: Float32Array = column("where on it", "R")
    v: Float32Array = column("likewise", "R")


def allocate_tracked_lanes(row_count: int, channel_count: int) -> TrackedLanes:
    """Zeroed `TrackedLanes`; one row in scenes where nothing varies."""
    return allocate(TrackedLanes, {"R": row_count, "C": channel_count})
