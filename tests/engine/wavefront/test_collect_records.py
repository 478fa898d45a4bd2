# SPDX-License-Identifier: GPL-3.0-or-later
"""The stage that makes records of ended paths counts what it throws away, apart from the picture's rejects."""

from __future__ import annotations

import numpy as np

from engine.guiding.records.vertices import (
    MAX_VERTICES,
    VERTEX_BEFORE,
    VERTEX_PDF,
    VERTEX_ROUGHNESS,
    VERTEX_THROUGHPUT,
    VertexLog,
    VertexRecords,
    allocate_log,
    allocate_vertex_records,
)
from engine.runtime.bundle import Bundle
from engine.state.lanes import RGB, PathState, allocate_paths
from engine.wavefront.collect_records import collect_records
from engine.wavefront.columns import COUNT_WIDTH, RECORD_REJECTS, RECORDS, RECORDS_DROPPED, REJECTS
from engine.wavefront.work import allocate_queue


class _Unit(Bundle):
    """What the stage reads of a unit."""

    pixel_weight: np.ndarray


class _Work(Bundle):
    """What it reads and writes of a thread's memory."""

    counts: np.ndarray
    paths: PathState
    log: VertexLog
    records: VertexRecords


def collected(gathered: np.ndarray, throughput: np.ndarray, room: int) -> _Work:
    """A thread's memory after paths of one vertex each have ended."""
    lanes = len(gathered)
    paths, log = allocate_paths(lanes), allocate_log(lanes, use_vertices=True)
    paths.radiance[:] = gathered[:, None]
    log.is_recording[:] = log.count[:] = 1
    first = log.real[::MAX_VERTICES]
    first[:, [VERTEX_ROUGHNESS, VERTEX_PDF]] = 1.0
    first[:, VERTEX_BEFORE : VERTEX_BEFORE + RGB] = 1.0
    first[:, VERTEX_THROUGHPUT : VERTEX_THROUGHPUT + RGB] = throughput[:, None]
    work = _Work(np.zeros(COUNT_WIDTH, np.int64), paths, log, allocate_vertex_records(room))
    queue = allocate_queue(lanes)
    queue.lanes[:], queue.count[0] = np.arange(lanes), lanes
    collect_records(None, _Unit(np.ones(1, np.float32)), work, queue)
    return work


def test_estimates_that_are_not_finite_are_counted_as_rejected_records_and_not_as_samples() -> None:
    # Without throughput nothing can be said of the light either; a NaN in the sum reads as no gain.
    work = collected(np.array([1.0, np.inf, 2.0, np.nan]), np.array([1.0, 1.0, 1.0, np.nan]), 4)
    assert work.counts[RECORDS] == 2 and work.counts[RECORD_REJECTS] == 2 and work.counts[REJECTS] == 0
    assert work.counts[RECORDS_DROPPED] == 0
    np.testing.assert_array_equal(work.records.radiance[:2, 0], [1.0, 2.0])


def test_records_without_room_are_counted() -> None:
    work = collected(np.array([1.0, 2.0, 3.0, 4.0, 5.0]), np.ones(5), 3)
    assert work.counts[RECORDS] == 3 and work.counts[RECORDS_DROPPED] == 2 and work.counts[RECORD_REJECTS] == 0
