# SPDX-License-Identifier: GPL-3.0-or-later
"""What is rendered when: schedules hand out tasks and are told of finished ones; they know nothing of rays or threads.

A task is a tile by a range of samples. Tasks of one tile follow each other in the order of their samples; those of
different tiles can be done at the same time. A guided render goes in iterations: all tiles' tasks of one, then
learning, then the next; once guiding is given up it goes on as an unguided one. With a noise threshold an unguided
render goes in steps, between which somebody looks at the picture and drops pixels.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from heapq import heapify, heappop, heappush
from typing import Protocol

from engine.guiding.policy.iterations import iteration_lengths
from engine.guiding.policy.trial import ArmSamples
from engine.render.strata import StrataSchedule
from engine.render.time_left import SHORTEST_PASS
from engine.state.unit import ALL_STRATA, CURRENT

#: Samples of a tile's successive tasks grow to this: each costs a start and an end with few paths in flight.
LARGEST_TASK_SAMPLES = 64
#: A task has at most the samples so far over this number, so that whenever a render is cancelled, tiles have nearly as
#: many samples as each other. It costs nothing that was seen (256 x 192 pixels, 192 samples: 8.97 s of processor time;
#: 9.04 s where tasks grew fourfold; 10.18 s where all had two samples).
_TASKS_SO_FAR = 8
#: But an unguided render's later tasks have at least so many, if a time limit leaves room: between two of them passes
#: the time of a hundred paths.
LEAST_TASK_SAMPLES = 4
#: The last task of the last tiles is divided, so that at the end no thread has long to wait for another: of how many
#: tiles, in how many parts, and how many samples make it worth while. They may not depend on the number of threads.
_LAST_TILES = 32
_LAST_PARTS = 4
_LEAST_DIVIDED = 32


def task_samples(first: int) -> int:
    """Samples of a task that begins with sample `first`; the first of all has one, for an early image."""
    return min(max(first // _TASKS_SO_FAR, SHORTEST_PASS), LARGEST_TASK_SAMPLES) if first else 1


def sample_ranges(
    samples: int, first: int = 0, count: int = 1, least: int = SHORTEST_PASS
) -> list[tuple[int, int]]:
    """(first, count) of a tile's successive tasks, from a first one of so many samples on; later ones have at least
    `least`.
    """
    ranges = []
    while first < samples:
        count = min(count, samples - first)
        ranges.append((first, count))
        first += count
        count = max(task_samples(first), least)
    return ranges


def _in_tasks(arms: Sequence[ArmSamples]) -> list[ArmSamples]:
    """An iteration's samples by arm as a tile's successive tasks."""
    return [
        ArmSamples(*task, arm)
        for first, count, arm in arms
        for task in sample_ranges(first + count, first, task_samples(first))
    ]


def _with_last_divided(ranges: list[tuple[int, int]]) -> list[tuple[int, int]]:
    """The same tasks, the last of them in parts."""
    first, count = ranges[-1]
    if count < _LEAST_DIVIDED:
        return ranges
    size = -(-count // _LAST_PARTS)
    return ranges[:-1] + [(first + part, min(size, count - part)) for part in range(0, count, size)]


@dataclass(frozen=True)
class Begin:
    """Where an unguided schedule begins, or a render is taken up that was interrupted in it.

    first, count : int, its first sample, and samples of each tile's first task
    ends : sequence of int or None, samples that each tile has by now; None: `first` each
    """

    first: int = 0
    count: int = 1
    ends: Sequence[int] | None = None


#: Of a whole render.
START = Begin()


def _left(ranges: list[tuple[int, int]], end: int) -> list[tuple[int, int]]:
    """What of a tile's tasks lies behind sample `end`."""
    return [(max(first, end), first + count - max(first, end)) for first, count in ranges if first + count > end]


@dataclass(frozen=True)
class Task:
    """A tile by a range of samples.

    tile : int
    arm_samples : ArmSamples, which samples, and by which arm
    stratum : int, part of u that they lie in, or ALL_STRATA
    weighs_as : int, the sample by which they are weighed: the first of their iteration
    is_first : bool, whether the tile has no samples before
    step, place : int, of an iteration, and of the task among the tile's in it
    is_aside : bool, whether something is tried in the iteration, but on none of the tile's pixels
    """

    tile: int
    arm_samples: ArmSamples
    stratum: int
    weighs_as: int
    is_first: bool
    step: int
    place: int = 0
    is_aside: bool = False


def is_alike(one: Task, other: Task) -> bool:
    """Whether two tasks are the same but for their tiles."""
    return (one.arm_samples, one.stratum, one.weighs_as) == (other.arm_samples, other.stratum, other.weighs_as)


class Schedule(Protocol):
    """Hands out tasks. Not safe for threads: who shares it locks it."""

    @property
    def has_task(self) -> bool:
        """Whether there is something to hand out now."""

    @property
    def lacks_first_tasks(self) -> bool:
        """Whether first tasks of tiles wait to be handed out."""

    def take(self) -> Task:
        """The next task; there must be one."""

    def clear(self) -> None:
        """Hand out no more of what waits."""

    def finish(self, task: Task) -> bool:
        """Take note of a finished task; True if the schedule waits for `begin`, which `PlainSchedule` never does."""


class PlainSchedule:
    """All samples of each tile, in tasks that grow; those at the very end are small again.

    Parameters
    ----------
    tile_count : int
    samples : int
    begin : Begin
    stratum : int
    """

    def __init__(self, tile_count: int, samples: int, begin: Begin = START, stratum: int = 0) -> None:
        ranges = sample_ranges(samples, begin.first, begin.count, LEAST_TASK_SAMPLES)
        divided_count = min(_LAST_TILES, tile_count) if ranges else 0
        #: By tile.
        self._ranges = [ranges] * (tile_count - divided_count)
        if divided_count:
            self._ranges += [_with_last_divided(ranges)] * divided_count
        if begin.ends is not None:
            self._ranges = [_left(of_tile, end) for of_tile, end in zip(self._ranges, begin.ends, strict=True)]
        self._stratum = stratum
        self._waiting = deque((tile, 0) for tile in range(tile_count) if self._ranges[tile])

    @property
    def has_task(self) -> bool:
        return bool(self._waiting)

    @property
    def lacks_first_tasks(self) -> bool:
        return any(self._ranges[tile][step][0] == 0 for tile, step in self._waiting)

    def take(self) -> Task:
        tile, step = self._waiting.popleft()
        first, count = self._ranges[tile][step]
        return Task(tile, ArmSamples(first, count, CURRENT), self._stratum, first, first == 0, step)

    def clear(self) -> None:
        self._waiting.clear()

    def finish(self, task: Task) -> bool:
        if task.step + 1 < len(self._ranges[task.tile]):
            self._waiting.append((task.tile, task.step + 1))
        return False


class PacedSchedule:
    """All samples of each tile, in passes over all tiles of which the clock says how long they are.

    Tiles that are behind come first. Nobody waits for anybody at the end of a pass, but before the shortest ones. Each
    of these may be cut off, so that it begins when all tiles have the same number of samples.

    Parameters
    ----------
    tile_count : int
    samples : int
    pace : callable (wanted, first) -> int
        Samples of the pass that begins now, of so many that are wanted, from a sample on.
    begin : Begin
    stratum : int
    """

    def __init__(
        self, tile_count: int, samples: int, pace: Callable[[int, int], int], begin: Begin = START, stratum: int = 0
    ) -> None:
        self._samples, self._pace, self._stratum = samples, pace, stratum
        self._next, self._count = begin.first, begin.count
        #: Of the passes so far.
        self._ranges: list[tuple[int, int]] = []
        #: Samples that tiles have of the first pass already.
        self._ends: Sequence[int] = [begin.first] * tile_count if begin.ends is None else begin.ends
        is_behind = min(self._ends, default=0) < max(self._ends, default=0)
        if begin.ends is not None and tile_count:
            # A pass in which all come as far as the first has.
            least, self._next = min(self._ends), max(self._ends)
            self._count = max(task_samples(self._next), LEAST_TASK_SAMPLES) if self._next else 1
            self._ranges = [(least, self._next - least)] if is_behind else []
        #: Whether the last of them begins when all tiles are there.
        self._waits_for_all = False
        #: Steps and tiles, a heap.
        self._waiting = [
            (int(is_behind and end == self._next), tile) for tile, end in enumerate(self._ends) if end < samples
        ]
        heapify(self._waiting)
        self._tile_count = len(self._waiting)

    @property
    def has_task(self) -> bool:
        if not self._waiting:
            return False
        step, _ = self._waiting[0]
        if step == len(self._ranges):
            self._begin_pass()
        if step + 1 < len(self._ranges):
            return True
        # No tile that waits is behind.
        self._waits_for_all &= len(self._waiting) < self._tile_count
        return not self._waits_for_all

    def _begin_pass(self) -> None:
        count = self._pace(min(self._count, self._samples - self._next), self._next)
        self._waits_for_all = bool(self._ranges) and count <= SHORTEST_PASS
        self._ranges.append((self._next, count))
        self._next += count
        self._count = max(task_samples(self._next), LEAST_TASK_SAMPLES)

    @property
    def lacks_first_tasks(self) -> bool:
        return any(step == 0 for step, _ in self._waiting) and (not self._ranges or self._ranges[0][0] == 0)

    def take(self) -> Task:
        step, tile = heappop(self._waiting)
        first, count = self._ranges[step]
        if step == 0:
            (first, count), = _left([(first, count)], self._ends[tile])
        return Task(tile, ArmSamples(first, count, CURRENT), self._stratum, first, first == 0, step)

    def clear(self) -> None:
        self._waiting.clear()

    def finish(self, task: Task) -> bool:
        if task.step + 1 < len(self._ranges) or self._next < self._samples:
            heappush(self._waiting, (task.step + 1, task.tile))
        return False


class Steps:
    """Steps, each of all tiles; between two of them somebody looks at the picture, and says which tiles there are.

    Parameters
    ----------
    samples : int
    next_look : callable (samples a pixel so far) -> int
        Samples a pixel at the end of the step that begins there; more than `samples` are never taken.
    begin : Begin
        Of the first step.
    stratum : int
    least : int
        Samples that later steps' first tasks have at least.
    """

    def __init__(
        self, samples: int, next_look: Callable[[int], int], begin: Begin = START, stratum: int = 0,
        least: int = SHORTEST_PASS,
    ) -> None:
        self._samples = samples
        self._next_look = next_look
        self._stratum = stratum
        self._least = least
        self._unfinished = 0
        self._tasks = PlainSchedule(0, 0)
        #: The step in work, or the first before it begins.
        self.begun = begin
        self._has_begun = False
        self.next_sample = begin.first

    def begin(self, tile_count: int) -> None:
        """Hand out the next step."""
        if self._has_begun:
            self.begun = Begin(self.next_sample, max(task_samples(self.next_sample), self._least))
        self._has_begun = True
        first, ends = self.next_sample, self.begun.ends
        self.next_sample = max(min(self._next_look(first), self._samples), max(ends or (0,)))
        self._tasks = PlainSchedule(tile_count, self.next_sample, self.begun, self._stratum)
        self._unfinished = tile_count if ends is None else sum(end < self.next_sample for end in ends)

    @property
    def is_over(self) -> bool:
        """Whether all of the step that began last is finished."""
        return not self._unfinished

    @property
    def is_last(self) -> bool:
        """Whether the samples are used up by the end of the step."""
        return self.next_sample >= self._samples

    @property
    def has_task(self) -> bool:
        return self._tasks.has_task

    @property
    def lacks_first_tasks(self) -> bool:
        return self._tasks.lacks_first_tasks

    def take(self) -> Task:
        return self._tasks.take()

    def clear(self) -> None:
        self._tasks.clear()

    def finish(self, task: Task) -> bool:
        self._tasks.finish(task)
        self._unfinished -= sum(task.arm_samples[:2]) == self.next_sample
        return not self._unfinished


class Iterations:
    """Iterations, each of all tiles; between two of them somebody learns, and says how the next is divided.

    Parameters
    ----------
    samples : int
    strata : StrataSchedule, optional
        Which stratum an iteration belongs to, and how long it is; without, lengths go by index.
    pace : callable (wanted, first) -> int, optional
        Samples of the iteration that begins now, of so many that are wanted, from a sample on.
    """

    def __init__(
        self, samples: int, strata: StrataSchedule | None = None, pace: Callable[[int, int], int] | None = None
    ) -> None:
        self._strata = strata
        self._pace = pace
        self._stratum = 0 if strata is None else ALL_STRATA
        self._ranges: list[tuple[int, int]] = []
        if strata is None:
            first = 0
            for length in iteration_lengths(samples):
                self._ranges.append((first, length))
                first += length
        self._step = self._planned = -1
        self._unfinished = 0
        self._arms: list[ArmSamples] = []
        #: Of the tiles from some index on, where these are divided otherwise.
        self._other_arms: list[ArmSamples] = []
        self._first_other = 0
        self._waiting: deque[tuple[int, int]] = deque()
        self.plan(0.0)

    @property
    def is_whole(self) -> bool:
        """Whether samples of the iteration lie in all of u."""
        return self._strata is None or self._stratum == ALL_STRATA

    @property
    def stratum(self) -> int:
        """Part of u that the iteration lies in."""
        return self._stratum

    def plan(self, seconds: float) -> tuple[int, int] | None:
        """The iteration that `begin` begins next: its first sample and samples a pixel; None: there is none.

        Asked again before that, it says the same.

        Parameters
        ----------
        seconds : float
            Time since the beginning.
        """
        if self._planned > self._step:
            return self._ranges[self._planned]
        if self._strata is not None:
            first = sum(self._ranges[-1]) if self._ranges else 0
            following = self._strata.next(first, seconds)
            if following is not None:
                self._stratum, count = following
                self._ranges.append((first, count))
        if self._step + 1 >= len(self._ranges):
            return None
        self._planned = step = self._step + 1
        first, wanted = self._ranges[step]
        if self._pace is not None and self._strata is None:
            count = self._pace(wanted, first)
            if count < wanted:
                self._ranges[step : step + 1] = [(first, count), (first + count, wanted - count)]
        return self._ranges[step]

    def begin(
        self, arms: Sequence[ArmSamples], tile_count: int, other_arms: Sequence[ArmSamples] = (), first_other: int = 0
    ) -> None:
        """Hand out the iteration that was planned, divided so, of so many tiles.

        Tiles from `first_other` on are divided as `other_arms` says, if there are any.
        """
        self._step = self._planned
        self._arms, self._other_arms = _in_tasks(arms), _in_tasks(other_arms)
        self._first_other = first_other if self._other_arms else tile_count
        self._unfinished = tile_count
        self._waiting.extend((tile, 0) for tile in range(tile_count))

    @property
    def next_sample(self) -> int:
        """Samples a pixel by the end of the iteration."""
        return sum(self._ranges[self._step])

    @property
    def in_hand(self) -> tuple[int, int]:
        """Samples that every pixel has, and the end of what may be out: that of the iteration that is planned."""
        first, count = self._ranges[self._step]
        return first + (count if self.is_over else 0), sum(self._ranges[max(self._planned, self._step)])

    @property
    def is_over(self) -> bool:
        """Whether all of the iteration that began last is finished."""
        return not self._unfinished

    @property
    def next_tile(self) -> int:
        """Of the task that is handed out next; there must be one."""
        return self._waiting[0][0]

    @property
    def has_task(self) -> bool:
        return bool(self._waiting)

    @property
    def lacks_first_tasks(self) -> bool:
        return self._step == 0 and self.has_task

    def take(self) -> Task:
        tile, place = self._waiting.popleft()
        first, is_aside = self._ranges[self._step][0], tile >= self._first_other
        arm_samples = self._arms_of(tile)[place]
        return Task(tile, arm_samples, self._stratum, first, self._step == 0, self._step, place, is_aside)

    def _arms_of(self, tile: int) -> list[ArmSamples]:
        return self._arms if tile < self._first_other else self._other_arms

    def clear(self) -> None:
        self._waiting.clear()

    def finish(self, task: Task) -> bool:
        if task.place + 1 < len(self._arms_of(task.tile)):
            self._waiting.append((task.tile, task.place + 1))
            return False
        self._unfinished -= 1
        return not self._unfinished
