# SPDX-License-Identifier: GPL-3.0-or-later
"""What a worker does at a time: tasks of several tiles.

Tasks are those that one machine's threads work on (`engine.render.schedule`), and each is put on the film by itself. So
float32 sums are added up in the same order as on one machine, however tasks are bundled, and the picture is the same to
the last bit.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from engine.render.render_loop import RenderLoop
from engine.render.schedule import Task, is_alike
from engine.state.unit import BRIDGE

#: Ranges a worker that the tasks of an iteration are divided into.
RANGES_PER_WORKER = 3
#: What a range costs whoever hands it out and takes it back, whatever is in it [s].
RANGE_SECONDS = 1.5e-3


def tiles_in_range(tile_count: int, worker_count: int, seconds: float | None) -> int:
    """How many of a pass's tiles a range is to have, at least one.

    A few ranges a worker, so that none waits long for the last; but no more than pay: R ranges by as many workers take
    R times `RANGE_SECONDS` here and an R-th of the pass there, which is least for R^2 = seconds / `RANGE_SECONDS`.

    Parameters
    ----------
    seconds : float or None
        What one worker would need for the pass; None: nobody knows yet.
    """
    range_count = float(RANGES_PER_WORKER * max(worker_count, 1))
    if seconds is not None:
        range_count = min(range_count, math.sqrt(seconds / RANGE_SECONDS))
    return max(int(tile_count / max(range_count, 1.0)), 1)


@dataclass(frozen=True)
class TaskRange:
    """Tasks of several tiles: the same samples of each, by the same arm.

    number : int, of all ranges of a render: whoever brings the same number brings the same sums
    tasks : tuple of Task
    path_count : int, paths that it takes
    """

    number: int
    tasks: tuple[Task, ...]
    path_count: int

    @property
    def is_bridge(self) -> bool:
        """Whether they bridge a learning (`engine.render.bridge`)."""
        return self.tasks[0].arm_samples.arm == BRIDGE

    def __str__(self) -> str:
        """For messages: which samples."""
        first, count, _arm = self.tasks[0].arm_samples
        return f"samples {first} to {first + count - 1} of a part of the picture"


class RangeCutter:
    """Bundles a loop's tasks in their order.

    Parameters
    ----------
    loop : RenderLoop
    """

    def __init__(self, loop: RenderLoop) -> None:
        self._loop = loop
        #: Was taken, and did not fit to those before.
        self._held: Task | None = None
        self._next_number = 0

    @property
    def has_task(self) -> bool:
        """Whether there is something to hand out now."""
        if not self._loop.has_task and self._loop.ended_by:
            self._held = None
        return self._held is not None or self._loop.has_task

    @property
    def next_task(self) -> Task:
        """The first task of the next range; there must be one."""
        if self._held is None:
            self._held = self._loop.take()
        return self._held

    def cut(self, tile_count: int, most_paths: int) -> TaskRange:
        """The next range: up to so many tiles, and paths if it is more than one tile. There must be a task."""
        tasks: list[Task] = []
        path_count = 0
        while len(tasks) < tile_count and self.has_task:
            task, self._held = self._held or self._loop.take(), None
            paths = len(self._loop.tiles[task.tile][0]) * task.arm_samples.sample_count
            if tasks and (not is_alike(task, tasks[0]) or path_count + paths > most_paths):
                self._held = task
                break
            tasks.append(task)
            path_count += paths
        number, self._next_number = self._next_number, self._next_number + 1
        return TaskRange(number, tuple(tasks), path_count)
