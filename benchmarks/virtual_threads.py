# SPDX-License-Identifier: GPL-3.0-or-later
"""A render by many threads that are not there: what each would wait for, told by one that does the work of all.

Every task is traced and learned from for real, one after the other. A task takes its thread as long as this one was at
it (processor time), and goes to whichever thread would have been free first. What memory and caches shared by many
cores cost is not in it.
"""

from __future__ import annotations

import heapq
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from engine.builder.scene import Scene
from engine.render.film import Film
from engine.render.job import AnyJob, Job
from engine.render.request import RenderRequest
from engine.render.schedule import Task
from engine.render.session import Session
from engine.render.tracer import Tracer
from engine.settings import RenderSettings
from engine.state.columns import copy_of, rows_of
from engine.state.film import FilmTile
from engine.state.unit import BRIDGE, Unit, UnitCosts


@dataclass
class Timeline:
    """What a virtual render's threads did [s].

    thread_count : int
    seconds : float, from the first task to the last
    tracing, learning : float, of all threads together
    interpreter : float, of `tracing` and `learning`: between kernels, where one thread at a time can be
    learned_count : int, how often was learned
    """

    thread_count: int
    seconds: float = 0.0
    tracing: float = 0.0
    learning: float = 0.0
    interpreter: float = 0.0
    learned_count: int = 0

    @property
    def busy(self) -> float:
        """Share of the threads' time in which they had something to do."""
        return (self.tracing + self.learning) / max(self.seconds * self.thread_count, 1e-9)

    @property
    def speedup(self) -> float:
        """Over one thread."""
        return (self.tracing + self.learning) / max(self.seconds, 1e-9)


@dataclass(order=True)
class _End:
    """When a thread is free again; `then` is what it does at that moment."""

    at: float
    number: int
    then: Callable[[], None] = field(compare=False)


class VirtualJob(Job):
    """One render by threads of which only one is there."""

    def __init__(self, tracer: Tracer, request: RenderRequest, film: Film, timeline: Timeline) -> None:
        super().__init__(tracer, request, film, 1)
        self._timeline = timeline
        self._now = 0.0
        self._ends: list[_End] = []
        self._number = 0
        self._free = timeline.thread_count
        self._is_learning = False
        #: Of the next iteration, handed out too early: the thread that learns is not there yet.
        self._early: list[Task] = []

    def start(self) -> None:
        """Load the kernels."""
        self._ready()
        self._loop.begin()

    def wait(self, seconds: float) -> bool:
        """Render all of it."""
        while True:
            while self._free and (task := self._next()) is not None:
                self._trace(task)
            if not self._ends:
                break
            end = heapq.heappop(self._ends)
            self._now = end.at
            self._free += 1
            end.then()
        self._timeline.seconds = self._now
        return True

    def _next(self) -> Task | None:
        if self._early and not self._is_learning:
            return self._early.pop()
        if self._early or not self._loop.has_task:
            return None
        task = self._loop.take()
        if self._is_learning and task.arm_samples.arm != BRIDGE:
            self._early.append(task)
            return None
        return task

    def _spend(self, seconds: float, then: Callable[[], None]) -> None:
        """One thread has so long to do."""
        self._free -= 1
        self._number += 1
        heapq.heappush(self._ends, _End(self._now + seconds, self._number, then))

    def _trace(self, task: Task) -> None:
        loop, batch, timeline = self._loop, self._batches[0], self._timeline
        began = time.thread_time()
        unit = loop.unit(task)
        self.tracer.trace_unit(batch, unit, self._stop_flag)
        records = batch.take_records() if loop.records(unit.arm) else None
        seconds = time.thread_time() - began
        timeline.tracing += seconds
        timeline.interpreter += max(seconds - batch.unit_costs.seconds, 0.0)
        # Other units are traced into the same memory before this one is put on the film.
        sums, costs = copy_of(rows_of(batch.film, 0, len(unit.pixels) * unit.strata)), batch.unit_costs
        self._spend(seconds, lambda: self._finish(task, unit, sums, costs, records))

    def _finish(self, task: Task, unit: Unit, sums: FilmTile, costs: UnitCosts, records: Any) -> None:
        loop, timeline = self._loop, self._timeline
        began = time.thread_time()
        with loop.film_lock:
            loop.keep(task, unit, sums, costs, records)
        with loop.changed:
            is_waiting = loop.finish(task)
        seconds = time.thread_time() - began
        timeline.interpreter += seconds
        timeline.tracing += seconds
        if not is_waiting:
            self._spend(seconds, lambda: None)
            return
        began = time.process_time()
        loop.begin_next(self._statistics_of_iterations())
        learning = time.process_time() - began
        timeline.learning += learning
        timeline.learned_count += 1
        self._is_learning = True
        self._spend(seconds + learning, self._has_learned)

    def _has_learned(self) -> None:
        self._is_learning = False


class VirtualSession(Session):
    """A session that renders with virtual threads.

    Parameters
    ----------
    settings : RenderSettings
    timeline : Timeline
        Gets what the render did.
    """

    def __init__(self, settings: RenderSettings, timeline: Timeline) -> None:
        super().__init__(settings)
        self.timeline = timeline

    def _job(
        self, scene: Scene, request: RenderRequest, film: Film, _ray_observer: Callable[..., None] | None
    ) -> AnyJob:
        tracer = self._take_tracer(scene, request.settings, film.layout)
        return VirtualJob(tracer, request, film, self.timeline)
