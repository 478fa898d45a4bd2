# SPDX-License-Identifier: GPL-3.0-or-later
"""Which schedule an unguided render goes by, or what is left of a guided one once guiding has been given up."""

from __future__ import annotations

from engine.render.adaptive import ActivePixels
from engine.render.schedule import LARGEST_TASK_SAMPLES, PacedSchedule, PlainSchedule, Steps
from engine.render.time_left import TimeLeft

#: Until the first look a step before a time limit has at most so many times the samples so far.
_STEP_GROWTH = 4


def plain_schedule(
    tile_count: int, samples: int, active: ActivePixels | None, time_left: TimeLeft, first: int, count: int,
    stratum: int,
) -> PlainSchedule | PacedSchedule | Steps:
    """All samples from `first` on, in tasks of which the first has `count` samples a pixel; steps have begun.

    Parameters
    ----------
    active : ActivePixels or None
        Which pixels go on, where there is a noise threshold.
    stratum : int
        As of `Task`.
    """
    if active is None and time_left.is_limited:
        return PacedSchedule(tile_count, samples, time_left.fit, first, count, stratum)
    if active is None:
        return PlainSchedule(tile_count, samples, first, count, stratum)
    next_look = active.rule.next_look

    def next_end(begin: int) -> int:
        wanted = next_look(begin) - begin
        if time_left.is_limited:
            # How long samples take is to be known soon.
            wanted = min(wanted, max(_STEP_GROWTH * begin, 1), LARGEST_TASK_SAMPLES)
        return begin + time_left.fit(wanted, begin)

    steps = Steps(samples, next_end, first, count, stratum)
    steps.begin(tile_count)
    return steps
