# SPDX-License-Identifier: GPL-3.0-or-later
"""Samples of some tiles, traced for somebody else's film: what a worker of a cluster does for one order."""

from __future__ import annotations

import queue
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np

from engine.array_types import Int32Array
from engine.guiding.policy.guidance import Guidance
from engine.guiding.policy.trial import ArmSamples
from engine.guiding.records.unit_records import UnitRecords
from engine.render.batch import Batch, Statistics
from engine.render.tiles import TILE_SIZE
from engine.render.tracer import Tracer
from engine.settings import RenderSettings
from engine.state.columns import rows_of
from engine.state.film import FilmTile, allocate_tile
from engine.state.lanes import RGB
from engine.state.unit import ALL_STRATA, Unit, UnitCosts

#: Of a tile: int32 (P, 2), column and row in the full image.
Pixels = Int32Array


@dataclass(frozen=True)
class TracedTiles:
    """Results of tasks of several tiles.

    sums : FilmTile, rows of all tiles one after the other
    costs : of each tile
    records : of each tile, None if they were not wanted
    """

    sums: FilmTile
    costs: list[UnitCosts]
    records: list[UnitRecords] | None


def trace_tiles(
    tracer: Tracer, settings: RenderSettings, thread_count: int, tiles: Sequence[Pixels], arm_samples: ArmSamples,
    stratum: int, guidance: Guidance | None, *, records: bool,
) -> tuple[TracedTiles, Statistics]:
    """As `engine.render.session.Session.trace_tiles`, by a tracer that has taken scene and settings."""
    strata = max(settings.strata, 1)
    # Always the same memory, however many tiles there are, so that it is kept from call to call.
    batches = tracer.make_batches(
        thread_count, TILE_SIZE**2 * strata, is_guided=settings.is_guided, records=guidance is not None
    )
    if not tracer.is_linked(batches[0]):
        tracer.warm_up(batches[0])
    if guidance is not None:
        tracer.guidance = guidance
    rows = strata if stratum == ALL_STRATA else 1
    offsets = np.cumsum([0, *(len(pixels) for pixels in tiles)])
    sums = allocate_tile(int(offsets[-1]) * rows, RGB, tracer.layout)
    free: queue.SimpleQueue[Batch] = queue.SimpleQueue()
    for batch in batches:
        free.put(batch)
    never = np.zeros(1, np.int32)

    def trace(index: int) -> tuple[UnitCosts, UnitRecords | None]:
        first, last = offsets[index], offsets[index + 1]
        unit = Unit(tiles[index], np.arange(first, last), *arm_samples, stratum, strata)
        batch = free.get()
        try:
            tracer.trace_unit(batch, unit, never)
            for column, of_tile in zip(sums, batch.film, strict=True):
                if len(column):
                    column[first * rows : last * rows] = of_tile[: (last - first) * rows]
            return batch.unit_costs, batch.take_records() if records else None
        finally:
            free.put(batch)

    with ThreadPoolExecutor(thread_count, thread_name_prefix="trace") as pool:
        costs, recorded = zip(*pool.map(trace, range(len(tiles))), strict=True)
    total = Statistics()
    for batch in batches:
        total.add(batch.statistics)
    return TracedTiles(sums, list(costs), list(recorded) if records else None), total


def split_records(together: UnitRecords, counts: Sequence[tuple[int, int]]) -> Iterator[UnitRecords]:
    """Records of units from those of all one after the other; `counts` are of vertices' and the cache's, by unit."""
    vertex = cache = 0
    for vertex_count, cache_count in counts:
        yield UnitRecords(
            rows_of(together.vertices, vertex, vertex + vertex_count),
            rows_of(together.cache_records, cache, cache + cache_count),
        )
        vertex, cache = vertex + vertex_count, cache + cache_count
