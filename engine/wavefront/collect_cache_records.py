# SPDX-License-Identifier: GPL-3.0-or-later
"""Stage: what ended paths have found teaches the radiance cache. Runs only if there is one and paths are recorded."""

from engine.guiding.records import cache_records
from engine.runtime.jit import kernel
from engine.wavefront.columns import CACHE_RECORDS, RECORD_REJECTS, RECORDS_DROPPED


@kernel
def collect_cache_records(scene, unit, work, queue):
    """Append what the queue's ended paths teach to `work.cache_records`; call before their lanes are freed."""
    work.counts[CACHE_RECORDS], reject_count, dropped_count = cache_records.collect_cache_records(
        work.paths, work.cached, queue.lanes, queue.count[0], work.cache_records, work.counts[CACHE_RECORDS]
    )
    work.counts[RECORD_REJECTS] += reject_count
    work.counts[RECORDS_DROPPED] += dropped_count
