# SPDX-License-Identifier: GPL-3.0-or-later
"""Stage: what ended paths have found teaches the radiance cache. Runs only if there is one and paths are recorded."""

from engine.guiding.records import taught
from engine.runtime.jit import kernel
from engine.wavefront.columns import RECORD_REJECTS, RECORDS_DROPPED, TAUGHT


@kernel
def collect_taught(scene, unit, work, queue):
    """Append what the queue's ended paths teach to `work.taught`; call before their lanes are freed."""
    work.counts[TAUGHT], reject_count, dropped_count = taught.collect_taught(
        work.paths, work.cached, queue.lanes, queue.count[0], work.taught, work.counts[TAUGHT]
    )
    work.counts[RECORD_REJECTS] += reject_count
    work.counts[RECORDS_DROPPED] += dropped_count
