# SPDX-License-Identifier: GPL-3.0-or-later
"""Samples that threads trace while one of them learns, so that none waits (docs/decisions/learning-beside-tracing.md).

An iteration of a guided render begins with them: they go by what the iteration before went by, and nothing is recorded.
How many they are depends on the iteration alone. What learning reads of the film, these samples do not change: their
sums are held until it has read it. So the picture is the same whatever ends first.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

from engine.guiding.policy.trial import ArmSamples
from engine.render.schedule import Begin, PlainSchedule, Task
from engine.state.columns import copy_of, rows_of
from engine.state.film import FilmTile
from engine.state.unit import BRIDGE, CURRENT, Unit

#: Samples a pixel of the shortest iteration that begins with a bridge: shorter ones have learned from little.
SHORTEST_BRIDGED = 16


def bridge_samples(arms: Sequence[ArmSamples], other_arms: Sequence[ArmSamples], samples: int) -> int:
    """Samples a pixel that are traced while learning goes on; 0: all threads wait.

    Parameters
    ----------
    arms, other_arms : sequence of ArmSamples
        Of the iteration that is learned from. Where it compares, what is learned decides by what to go on.
    samples : int
        A pixel, of the iteration that follows.
    """
    if other_arms or len(arms) > 1 or arms[0].arm != CURRENT or samples < SHORTEST_BRIDGED:
        return 0
    return samples // 2


@dataclass(frozen=True)
class _Held:
    units: Sequence[Unit]
    sums: FilmTile


class Bridge:
    """A schedule of the samples that bridge one learning.

    Who shares it locks as `RenderLoop` says: its tasks by `changed`, sums by `film_lock`.

    Parameters
    ----------
    put : callable (units, sums, weight) -> None
        Puts sums on the film, with the weight of each of their samples.
    """

    def __init__(self, put: Callable[[Sequence[Unit], FilmTile, float], object]) -> None:
        self._put = put
        self._tasks = PlainSchedule(0, 0)
        self._end = 0
        self._weight = 1.0
        self._unfinished: set[int] = set()
        self._held: list[_Held] | None = None

    def begin(self, first: int, count: int, tile_count: int, weight: float) -> None:
        """Hand out so many samples of each tile from sample `first` on, and hold their sums until `let_go`."""
        self._tasks, self._end = PlainSchedule(tile_count, first + count, Begin(first, count)), first + count
        self._unfinished, self._held = set(range(tile_count)), []
        self._weight = weight

    def let_go(self) -> None:
        """Learning has read the film: put on it what was held, and what comes from now on at once."""
        held, self._held = self._held or (), None
        for one in held:
            self._put(one.units, one.sums, self._weight)

    @property
    def is_traced(self) -> bool:
        """Whether nothing of it is left to do."""
        return not self._unfinished

    def has_traced(self, tile: int) -> bool:
        """Whether nothing of it is left to do in a tile."""
        return tile not in self._unfinished

    def keep(self, units: Sequence[Unit], sums: FilmTile) -> None:
        """Take the sums of finished units; rows are of one unit after the other."""
        if self._held is None:
            self._put(units, sums, self._weight)
            return
        rows = sum(len(unit.pixels) for unit in units)
        # The thread needs its memory for its next unit.
        self._held.append(_Held(units, copy_of(rows_of(sums, 0, rows))))

    @property
    def has_task(self) -> bool:
        return self._tasks.has_task

    @property
    def lacks_first_tasks(self) -> bool:
        return False

    def take(self) -> Task:
        task = self._tasks.take()
        return replace(task, arm_samples=task.arm_samples._replace(arm=BRIDGE))

    def clear(self) -> None:
        self._tasks.clear()

    def finish(self, task: Task) -> bool:
        self._tasks.finish(task)
        if sum(task.arm_samples[:2]) == self._end:
            self._unfinished.discard(task.tile)
        return False
