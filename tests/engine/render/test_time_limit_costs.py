# SPDX-License-Identifier: GPL-3.0-or-later
"""What a time limit costs: samples lost to short tasks and to threads that wait, by a clock that is made up.

Real clocks tell nothing here: what is lost is less than what machines differ by from one render to the next.
"""

from __future__ import annotations

import heapq
import random

import pytest

from engine.guiding.policy.trial import ArmSamples
from engine.render.schedule import Iterations, PacedSchedule, PlainSchedule, Schedule, Task
from engine.render.time_left import TimeLeft
from engine.state.unit import CURRENT

#: A picture of 480 x 270.
TILES = 135
#: What a task takes beside its samples, and what learning takes between iterations [s].
TASK_SECONDS, LEARNING_SECONDS = 2e-4, 1e-3
MANY = 1 << 14


class Clock:
    """Threads that take tasks, and when they finish them; some tiles take three times as long as others."""

    def __init__(self, threads: int, tile_seconds: float) -> None:
        self.now = 0.0
        self._idle, self._work = threads, list[tuple[float, int, Task]]()
        self._random = random.Random(threads)
        self._seconds = [self._random.uniform(0.5, 1.5) * tile_seconds for _ in range(TILES)]

    def render(self, schedule: Schedule, limit: float) -> float:
        """Samples a pixel that are done once the limit is over and all tasks are."""
        done, handed_out = 0, 0
        while True:
            while self._idle and self.now < limit and schedule.has_task:
                task = schedule.take()
                seconds = self._seconds[task.tile] * self._random.uniform(0.9, 1.1) * task.arm_samples.sample_count
                heapq.heappush(self._work, (self.now + TASK_SECONDS + seconds, handed_out, task))
                self._idle, handed_out = self._idle - 1, handed_out + 1
            if not self._work:
                return done / TILES
            self.now, _, task = heapq.heappop(self._work)
            self._idle += 1
            done += task.arm_samples.sample_count
            if schedule.finish(task) and isinstance(schedule, Iterations):
                self.now += LEARNING_SECONDS
                following = schedule.plan(self.now)
                if following is not None:
                    schedule.begin([ArmSamples(*following, CURRENT)], TILES)


def samples_per_second(
    monkeypatch: pytest.MonkeyPatch, threads: int, tile_seconds: float, limit: float, *, is_limited: bool,
    is_guided: bool,
) -> float:
    clock = Clock(threads, tile_seconds)
    monkeypatch.setattr(TimeLeft, "elapsed", property(lambda _: clock.now))
    pace = TimeLeft(limit if is_limited else 0.0).fit
    schedule: Schedule = PacedSchedule(TILES, MANY, pace) if is_limited else PlainSchedule(TILES, MANY)
    if is_guided:
        schedule = iterations = Iterations(MANY, None, pace)
        iterations.begin([ArmSamples(0, 1, CURRENT)], TILES)
    return clock.render(schedule, limit) / clock.now


@pytest.mark.parametrize("is_guided", [False, True], ids=["unguided", "guided"])
@pytest.mark.parametrize("threads", [2, 8])
@pytest.mark.parametrize("limit", [5.0, 10.0])
def test_cheap_pictures_lose_two_samples_in_a_hundred_at_most(
    monkeypatch: pytest.MonkeyPatch, limit: float, threads: int, is_guided: bool
) -> None:
    """Two million paths a second and thread: a plane and a lamp."""
    limited, unlimited = (
        samples_per_second(monkeypatch, threads, 5e-4, limit, is_limited=is_limited, is_guided=is_guided)
        for is_limited in (True, False)
    )
    print(f"{limit} s, {threads} threads: {limited / unlimited:.4f}")
    assert limited > 0.98 * unlimited
