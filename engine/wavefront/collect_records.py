# SPDX-License-Identifier: GPL-3.0-or-later
"""Stage: what ended paths have found becomes records to learn from. Runs only if paths are recorded."""

from engine.guiding.records import vertices
from engine.kernels.constants import DISTANT
from engine.runtime.jit import kernel
from engine.wavefront.columns import RECORD_REJECTS, RECORDS, RECORDS_DROPPED


@kernel
def collect_records(scene, unit, work, queue):
    """Append the records of the queue's ended paths to `work.records`; call before their lanes are freed."""
    work.counts[RECORDS], reject_count, dropped_count = vertices.collect_records(
        work.log, work.paths, unit.pixel_weight, queue.lanes, queue.count[0], DISTANT, work.records,
        work.counts[RECORDS],
    )
    work.counts[RECORD_REJECTS] += reject_count
    work.counts[RECORDS_DROPPED] += dropped_count
