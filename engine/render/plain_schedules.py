# SPDX-License-Identifier: GPL-3.0-or-later
"""Which schedule an unguided render goes by, or what is left of a guided one once guiding has been given up."""

from __future__ import annotations

from engine.render.looks import Looks
from engine.render.schedule import (
    LARGEST_TASK_SAMPLES,
    LEAST_TASK_SAMPLES,
    PacedSchedule,
    PlainSchedule,
    Steps,
    sample_ranges,
)
from engine.render.time_left import SHORTEST_PASS, TimeLeft

#: Until the first look a step before a time limit has at most so many times the samples so far.
_STEP_GROWTH = 4


def plain_schedule(
    tile_count: int, samples: int, looks: Looks, time_left: TimeLeft, first: int, count: int,
    stratum: int,
) -> PlainSchedule | PacedSchedule | Steps:
    """All samples from `first` on, in tasks of which the first has `count` samples a pixel; steps have begun.

    Parameters
    ----------
    looks : Looks
    stratum : int
        As of `Task`.
    """
    active, denoised = looks.active, looks.denoised
    has_looks = active is not None or denoised is not None
    if not has_looks and time_left.is_limited:
        return PacedSchedule(tile_count, samples, time_left.fit, first, count, stratum)
    if not has_looks:
        return PlainSchedule(tile_count, samples, first, count, stratum)
    # Where tasks end anyway: floating-point sums are those of a render that nobody looks at.
    ends = [sum(task) for task in sample_ranges(samples, first, count, LEAST_TASK_SAMPLES)] if denoised else []

    def next_end(begin: int) -> int:
        wanted = samples - begin if active is None else active.rule.next_look(begin) - begin
        if denoised is not None and (active is None or not active.has_looked):
            due = denoised.due
            wanted = min(wanted, next((end for end in ends if end >= due), samples) - begin)
        if time_left.is_limited:
            # How long samples take is to be known soon.
            wanted = min(wanted, max(_STEP_GROWTH * begin, 1), LARGEST_TASK_SAMPLES)
        return begin + time_left.fit(wanted, begin)

    least = SHORTEST_PASS if denoised is None else LEAST_TASK_SAMPLES
    steps = Steps(samples, next_end, first, count, stratum, least)
    steps.begin(tile_count)
    return steps
