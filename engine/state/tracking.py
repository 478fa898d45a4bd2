# SPDX-License-Identifier: GPL-3.0-or-later
"""Media that vary in space: bounds on what they are anywhere, and by lane how far a ray has been followed in them."""

from __future__ import annotations

import numpy as np

from engine.array_types import Float32Array, Int32Array, Int64Array, Uint8Array
from engine.runtime.bundle import Bundle

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
    """Rays that are followed through media that vary: a row for each of L paths, then one for each of L shadow rays.

    is_tracked : uint8, whether the path's ray is followed at all in this round
    position, end : float32 [m], along the ray: how far it has come, and where the surface is
    weight : float32 (R, C), of what is left of the light along the ray
    emitted : float32 (R, C), what the media on the way have emitted, seen from the ray's start
    chosen : int32, entry of the row's media that may collide at `position`, of a shadow ray boundaries that may lie
        behind the next one; majorant : float32 [m^-1], of what may collide
    collision : float32 [m], where the path is scattered, -1: nowhere
    step : int32, possible collisions so far
    u_event, u_roulette : float32, random numbers for what becomes of the ray at `position`
    lamp : int32, lamp on the ray whose light is seen, -1 = none; lamp_count : int32, of how many it was picked;
        lamp_distance : float32 [m]; lamp_weight : float32 (R, C), `weight` there
    origin : float32 (R, 3), rest : float32 [m], of a shadow ray from the boundary on that it has crossed last
    instance, triangle : int32, of the next boundary, instance -1 = none; u, v : float32, where on it
    """

    is_tracked: Uint8Array
    position: Float32Array
    end: Float32Array
    weight: Float32Array
    emitted: Float32Array
    chosen: Int32Array
    majorant: Float32Array
    collision: Float32Array
    step: Int32Array
    u_event: Float32Array
    u_roulette: Float32Array
    lamp: Int32Array
    lamp_count: Int32Array
    lamp_distance: Float32Array
    lamp_weight: Float32Array
    origin: Float32Array
    rest: Float32Array
    instance: Int32Array
    triangle: Int32Array
    u: Float32Array
    v: Float32Array


def allocate_tracked_lanes(row_count: int, channel_count: int) -> TrackedLanes:
    """Zeroed `TrackedLanes`; one row in scenes where nothing varies."""
    real, integer = np.float32, np.int32
    scalars = {
        "position": real, "end": real, "chosen": integer, "majorant": real, "collision": real, "step": integer,
        "u_event": real, "u_roulette": real,
        "lamp": integer, "lamp_count": integer, "lamp_distance": real, "rest": real, "instance": integer,
        "triangle": integer, "u": real, "v": real, "is_tracked": np.uint8,
    }
    arrays = {name: np.zeros(row_count, dtype) for name, dtype in scalars.items()}
    by_channel = {
        name: np.zeros((row_count, channel_count), real) for name in ("weight", "emitted", "lamp_weight")
    }
    return TrackedLanes(**arrays, **by_channel, origin=np.zeros((row_count, 3), real))
