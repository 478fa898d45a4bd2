# SPDX-License-Identifier: GPL-3.0-or-later
"""What a path teaches the cache is what it gained behind a surface, over the throughput with which it arrived there.

It weighs as much as that throughput, and a tenth of it behind the first surface.
"""

from __future__ import annotations

import numpy as np

from engine.guiding.records.cache_records import CacheRecords, allocate_cache_records
from engine.runtime.bundle import Bundle
from engine.state.lanes import (
    CACHE_VERTEX_BEFORE,
    CACHE_VERTEX_NG,
    CACHE_VERTEX_P,
    CACHE_VERTEX_RADIANCE,
    CACHE_VERTEX_SIDE,
    MAX_CACHE_VERTICES,
    RGB,
    CachedLanes,
    PathState,
    allocate_cached_lanes,
    allocate_paths,
)
from engine.wavefront.collect_cache_records import collect_cache_records
from engine.wavefront.columns import CACHE_RECORDS, COUNT_WIDTH, RECORD_REJECTS, RECORDS_DROPPED
from engine.wavefront.work import allocate_queue


class _Work(Bundle):
    """What the stage reads and writes of a thread's memory."""

    counts: np.ndarray
    paths: PathState
    cached: CachedLanes
    cache_records: CacheRecords


def collected(gathered: np.ndarray, surfaces: int, room: int) -> _Work:
    """A thread's memory after paths that met so many surfaces each have ended; before surface k a path had found k."""
    lanes = len(gathered)
    paths, cached = allocate_paths(lanes), allocate_cached_lanes(lanes)
    paths.radiance[:] = gathered[:, None]
    cached.is_recorded[:], cached.vertex_count[:] = 1, surfaces
    for lane in range(lanes):
        for k in range(surfaces):
            row = cached.vertices[lane * MAX_CACHE_VERTICES + k]
            row[CACHE_VERTEX_P : CACHE_VERTEX_P + 3], row[CACHE_VERTEX_NG + 2] = (lane, k, 0.0), 1.0
            row[CACHE_VERTEX_BEFORE : CACHE_VERTEX_BEFORE + RGB] = 0.5**k
            row[CACHE_VERTEX_RADIANCE : CACHE_VERTEX_RADIANCE + RGB], row[CACHE_VERTEX_SIDE] = k, 7 + k
            cached.vertex_program[lane * MAX_CACHE_VERTICES + k] = 10 * k
    work = _Work(np.zeros(COUNT_WIDTH, np.int64), paths, cached, allocate_cache_records(room))
    queue = allocate_queue(lanes)
    queue.lanes[:], queue.count[0] = np.arange(lanes), lanes
    collect_cache_records(None, None, work, queue)
    return work


def test_a_record_is_the_gain_over_the_throughput() -> None:
    work = collected(np.array([3.0, 5.0], np.float32), 2, 8)
    assert work.counts[CACHE_RECORDS] == 4
    np.testing.assert_array_equal(work.cache_records.radiance[:4, 0], [3.0, 2.0 / 0.5, 5.0, 4.0 / 0.5])
    np.testing.assert_array_equal(work.cache_records.position[:4, :2], [[0, 0], [0, 1], [1, 0], [1, 1]])
    np.testing.assert_array_equal(work.cache_records.program[:4], [0, 10, 0, 10])
    np.testing.assert_array_equal(work.cache_records.side[:4], [7, 8, 7, 8])
    np.testing.assert_allclose(work.cache_records.weight[:4, 2], [1.0, 0.05, 1.0, 0.05])


def test_what_is_not_finite_and_what_has_no_room_is_counted() -> None:
    work = collected(np.array([np.inf, np.nan, 2.0, 2.0], np.float32), 1, 3)
    assert work.counts[RECORD_REJECTS] == 2 and work.counts[CACHE_RECORDS] == 2 and work.counts[RECORDS_DROPPED] == 0
    assert collected(np.ones(4, np.float32), 1, 3).counts[RECORDS_DROPPED] == 1
