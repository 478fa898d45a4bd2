# SPDX-License-Identifier: GPL-3.0-or-later
"""What recorded paths teach the radiance cache: the light that surfaces send back along them.

A path gathers its radiance in one sum. The light that a surface sends back is therefore what the sum gains once the
path has arrived there, divided by the throughput with which it arrived: light sampling at the surface, what scattering
finds, and all that lies behind. What the surface emits is no part of it: surfaces that emit are left out.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from engine.array_types import Float32Array, Int32Array
from engine.kernels.constants import FLOAT_MAX
from engine.runtime.bundle import Bundle
from engine.runtime.jit import kernel
from engine.state.columns import allocate, column, joined
from engine.state.lanes import (
    CACHE_VERTEX_BEFORE,
    CACHE_VERTEX_NG,
    CACHE_VERTEX_P,
    CACHE_VERTEX_RADIANCE,
    CACHE_VERTEX_SIDE,
    MAX_CACHE_VERTICES,
    RGB,
)

#: Records that a unit of work may make.
CACHE_RECORD_ROWS = 1 << 16
#: Weight of what a path meets behind the first surface that it teaches. Few paths end there, and such surfaces lie
#: elsewhere in the same cell: they count where nothing better is known.
_FAR = np.float32(0.1)
#: Share of the sum by which it may fall for rounding alone.
_ROUNDING = np.float32(1e-5)


class CacheRecords(Bundle):
    """Light that surfaces send back along paths, R rows."""

    position: Float32Array = column("world [m]", "R", RGB)
    normal: Float32Array = column("geometric, unit, on the side that the path came from", "R", RGB)
    program: Int32Array = column("of the surface's shader", "R")
    radiance: Float32Array = column("sent back along the path", "R", RGB)
    weight: Float32Array = column("throughput with which the path arrived; less behind the first surface", "R", RGB)
    side: Float32Array = column("of the footprint with which the path arrived [m]", "R")


def allocate_cache_records(row_count: int) -> CacheRecords:
    """Zeroed `CacheRecords` of `row_count` rows."""
    return allocate(CacheRecords, {"R": row_count})


def join_cache_records(units: Sequence[CacheRecords]) -> CacheRecords:
    """Records of all units one after the other."""
    return joined(units)


@kernel
def collect_cache_records(paths, cached, lanes, lane_count, records, record_count):
    """Turn what ended paths among `lanes` have met into records; call before their lanes are freed.

    Returns
    -------
    record_count : int
        Rows in use.
    reject_count : int
        Estimates that were not finite.
    dropped_count : int
        Surfaces for whose records there was no room.
    """
    capacity = records.program.shape[0]
    reject_count = 0
    dropped_count = 0
    for k in range(lane_count):
        lane = lanes[k]
        if paths.alive[lane] != 0 or cached.is_recorded[lane] == 0:
            continue
        for vertex in range(cached.vertex_count[lane]):
            if record_count >= capacity:
                dropped_count += 1
                continue
            row = lane * MAX_CACHE_VERTICES + vertex
            is_finite = True
            share = np.float32(1.0) if vertex == 0 else _FAR
            for c in range(RGB):
                # Rounding of the long sum may leave a little less than before; a lamp of negative strength leaves much
                # less. A channel that the path had lost before tells nothing; it never sees the cell's either.
                gathered = cached.vertices[row, CACHE_VERTEX_RADIANCE + c]
                gain = paths.radiance[lane, c] - gathered
                if gain < 0.0 and -gain <= _ROUNDING * abs(gathered):
                    gain = np.float32(0.0)
                before = cached.vertices[row, CACHE_VERTEX_BEFORE + c]
                value = gain / before if before > 0.0 else np.float32(0.0)
                is_finite = is_finite and abs(value) < FLOAT_MAX
                records.weight[record_count, c] = share * before
                records.radiance[record_count, c] = value
                records.position[record_count, c] = cached.vertices[row, CACHE_VERTEX_P + c]
                records.normal[record_count, c] = cached.vertices[row, CACHE_VERTEX_NG + c]
            if is_finite:
                records.side[record_count] = cached.vertices[row, CACHE_VERTEX_SIDE]
                records.program[record_count] = cached.vertex_program[row]
                record_count += 1
            else:
                reject_count += 1
    return record_count, reject_count, dropped_count
