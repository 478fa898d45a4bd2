# SPDX-License-Identifier: GPL-3.0-or-later
"""What an unguided render goes by, or what is left of a guided one once guiding has been given up."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from engine.render.looks import Looks
from engine.render.loop_state import LoopState
from engine.render.schedule import (
    LARGEST_TASK_SAMPLES,
    LEAST_TASK_SAMPLES,
    START,
    Begin,
    PacedSchedule,
    PlainSchedule,
    Steps,
    Task,
    sample_ranges,
)
from engine.render.time_left import SHORTEST_PASS, TimeLeft

#: Of `ENDINGS`, those that are found by looking. Whether samples or time are used up, who takes a render up sees.
_GOOD_ENOUGH = ("NOISE_THRESHOLD", "DENOISED_THRESHOLD")
#: Until the first look a step before a time limit has at most so many times the samples so far.
_STEP_GROWTH = 4


def plain_schedule(
    tile_count: int, samples: int, looks: Looks, time_left: TimeLeft, begin: Begin, stratum: int
) -> PlainSchedule | PacedSchedule | Steps:
    """All samples from where it begins on; steps have begun.

    Parameters
    ----------
    looks : Looks
    begin : Begin
    stratum : int
        As of `Task`.
    """
    active, denoised = looks.active, looks.denoised
    has_looks = active is not None or denoised is not None
    if not has_looks and time_left.is_limited:
        return PacedSchedule(tile_count, samples, time_left.fit, begin, stratum)
    if not has_looks:
        return PlainSchedule(tile_count, samples, begin, stratum)
    # Where tasks end anyway: floating-point sums are those of a render that nobody looks at.
    ranges = sample_ranges(samples, begin.first, begin.count, LEAST_TASK_SAMPLES) if denoised else []
    ends = [sum(task) for task in ranges]

    def next_end(first: int) -> int:
        wanted = samples - first if active is None else active.rule.next_look(first) - first
        if denoised is not None and (active is None or not active.has_looked):
            due = denoised.due
            wanted = min(wanted, next((end for end in ends if end >= due), samples) - first)
        if time_left.is_limited:
            # How long samples take is to be known soon.
            wanted = min(wanted, max(_STEP_GROWTH * first, 1), LARGEST_TASK_SAMPLES)
        return first + time_left.fit(wanted, first)

    least = SHORTEST_PASS if denoised is None else LEAST_TASK_SAMPLES
    steps = Steps(samples, next_end, begin, stratum, least)
    steps.begin(tile_count)
    return steps


class PlainPart:
    """The unguided part of a render: its schedule, and which samples each tile has on the film.

    Who shares it holds the film's lock for `keep`, and that of the tasks for `begin` and `begin_step`.

    Parameters
    ----------
    samples : int
    looks : Looks
    time_left : TimeLeft
    stratum : int
        As of `Task`.
    skipped : int
        As of `LoopState`.
    """

    def __init__(self, samples: int, looks: Looks, time_left: TimeLeft, stratum: int, skipped: int) -> None:
        self._samples, self._looks, self._time_left, self._stratum = samples, looks, time_left, stratum
        self.skipped = skipped
        self._begun = START
        self._tile_count = 0
        #: By tile.
        self._ends: dict[int, int] = {}
        #: Between which somebody looks at the picture; None: nobody does.
        self.steps: Steps | None = None

    def begin(self, tile_count: int, begin: Begin) -> PlainSchedule | PacedSchedule | Steps:
        """The schedule of all that is left."""
        self._begun, self._tile_count, self._ends = begin, tile_count, dict(enumerate(begin.ends or ()))
        schedule = plain_schedule(tile_count, self._samples, self._looks, self._time_left, begin, self._stratum)
        self.steps = schedule if isinstance(schedule, Steps) else None
        return schedule

    def begin_step(self, tile_count: int) -> None:
        """Hand out the next step."""
        assert self.steps is not None
        self._tile_count, self._ends = tile_count, {}
        self.steps.begin(tile_count)

    @property
    def is_between_steps(self) -> bool:
        """Whether somebody looks at the picture, or is to."""
        return self.steps is not None and self.steps.is_over

    def keep(self, tasks: Sequence[Task]) -> None:
        """Take note of alike tasks whose samples are on the film now."""
        first, count, _arm = tasks[0].arm_samples
        self._ends |= dict.fromkeys((task.tile for task in tasks), first + count)

    def state(self, path_count: int, ended_by: str) -> LoopState:
        """How far it has come."""
        begin = self._begun if self.steps is None else self.steps.begun
        ends = np.array([self._ends.get(tile, begin.first) for tile in range(self._tile_count)], np.int32)
        return LoopState(
            begin.first, begin.count, ends, self.skipped, self._time_left.elapsed, path_count,
            ended_by if ended_by in _GOOD_ENOUGH else "", self._looks.state,
        )
