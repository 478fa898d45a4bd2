# SPDX-License-Identifier: GPL-3.0-or-later
"""One render's threads: they take tasks from its loop, trace them, and bring the results."""

from __future__ import annotations

import threading
import time
from concurrent.futures import ThreadPoolExecutor
from typing import Protocol

import numpy as np

from engine.guiding.policy.guidance import Guidance
from engine.guiding.policy.learner import Learner
from engine.render.batch import Batch, Statistics
from engine.render.compile_progress import FirstCalls
from engine.render.film import Film
from engine.render.looks import Looks
from engine.render.loop_job import RenderLoopJob
from engine.render.loop_state import LoopState
from engine.render.render_loop import RenderLoop
from engine.render.report import Progress
from engine.render.request import RenderRequest
from engine.render.schedule import Task
from engine.render.tracer import Tracer
from engine.scene.description import Notice

_PREPARING = "Preparing kernels"


class AnyJob(Protocol):
    """One render, whoever does it: this process's threads, or a cluster's workers. Methods are as `Job` has them."""

    film: Film
    #: Of `ENDINGS`, once it is known.
    ended_by: str
    prepare_seconds: float
    render_seconds: float

    @property
    def film_lock(self) -> threading.Lock:
        """For whoever reads the film meanwhile."""

    def holding_tasks(self) -> threading.Condition:
        """Within it no task is handed out or finished."""

    def state(self, *, is_over: bool) -> LoopState | None:
        """How far it has come, for who holds tasks and film; None: a while later there will be an answer."""

    @property
    def learner(self) -> Learner | None:
        """What learns."""

    @property
    def guidance(self) -> Guidance | None:
        """What the newest samples went by."""

    @property
    def looks(self) -> Looks:
        """Who looks at the picture meanwhile."""

    @property
    def has_paths(self) -> bool:
        """Whether there is anything to show."""

    @property
    def is_preparing(self) -> bool:
        """Whether a thread of this process may go on after `join`."""

    @property
    def notices(self) -> list[Notice]:
        """What users should know of how it went."""

    def start(self) -> None:
        """Begin."""

    def stop(self) -> None:
        """End soon."""

    def wait(self, seconds: float) -> bool:
        """Wait a little; True once all is done."""

    def join(self) -> None:
        """Wait for the end."""

    def statistics(self) -> Statistics:
        """What was counted."""

    def progress(self) -> Progress:
        """Where it stands."""


class Job(RenderLoopJob):
    """One render.

    Parameters
    ----------
    tracer : Tracer
        That has taken the scene.
    request : RenderRequest
    film : Film
        As `request.make_film` makes it.
    thread_count : int
    """

    def __init__(self, tracer: Tracer, request: RenderRequest, film: Film, thread_count: int) -> None:
        self.tracer, self.film, self.settings = tracer, film, request.settings
        self.thread_count = thread_count
        self.prepare_seconds = 0.0
        self.render_seconds = 0.0
        self._loop = RenderLoop(request, film, thread_count, tracer.follow, tracer.light_clusters)
        self._busy = 0
        #: Read by kernels: not 0 ends them after the round in work.
        self._stop_flag = np.zeros(1, np.int32)
        self._batches: list[Batch] = []
        self._pool = ThreadPoolExecutor(thread_count, thread_name_prefix="trace")
        self._futures: list = []
        self._created = time.perf_counter()
        self._first_calls = FirstCalls()

    def start(self) -> None:
        """Begin: one thread readies the kernels on a single path, then all trace."""
        self._futures = [self._pool.submit(self._prepare)]

    def stop(self) -> None:
        """Ask all threads to stop at the next stage."""
        self._loop.looks.stop()
        with self._loop.changed:
            self._stop_flag[0] = 1
            self._loop.changed.notify_all()

    @property
    def _stop(self) -> bool:
        """True once `stop` was called."""
        return bool(self._stop_flag[0])

    def wait(self, seconds: float) -> bool:
        """Wait a little; True once all is done. Raises what a thread raised."""
        deadline = time.perf_counter() + seconds
        while True:
            pending = [future for future in list(self._futures) if not future.done()]
            if not pending:
                for future in list(self._futures):
                    future.result()
                if all(future.done() for future in self._futures):
                    return True
                continue
            left = deadline - time.perf_counter()
            if left <= 0.0:
                return False
            try:
                pending[0].exception(timeout=left)
            except TimeoutError:
                return False

    @property
    def is_preparing(self) -> bool:
        """Whether kernels are still being loaded, which cannot be interrupted where one must be compiled."""
        return not self._loop.time_left.has_begun

    def join(self) -> None:
        """Wait for the threads to end; but once stopped, not for one that readies kernels and will notice later."""
        self._pool.shutdown(wait=not (self._stop and self.is_preparing))
        self.render_seconds = self._loop.end()

    def statistics(self) -> Statistics:
        """Sum over threads."""
        total = self._statistics_of_iterations()
        for batch in self._batches:
            total.add(batch.bridge_statistics)
        return total

    def _statistics_of_iterations(self) -> Statistics:
        """Without bridges."""
        total = Statistics()
        for batch in self._batches:
            total.add(batch.statistics)
        return total

    def progress(self) -> Progress:
        """Where it stands now."""
        if self.is_preparing:
            elapsed = time.perf_counter() - self._created
            message = self._first_calls.message(_PREPARING)
            return Progress(0.0, 0, self._loop.samples, elapsed, None, 0.0, message)
        counted = [one for batch in self._batches for one in (batch.statistics, batch.bridge_statistics)]
        return self._loop.progress(sum(sum(one.rays.values()) for one in counted))

    def _prepare(self) -> None:
        self._ready()
        self.prepare_seconds = time.perf_counter() - self._created
        if self._stop:
            return
        self._loop.begin()
        self._futures += [self._pool.submit(self._work, batch) for batch in self._batches]

    def _ready(self) -> None:
        """Have memory for all threads, and kernels."""
        tracer, loop = self.tracer, self._loop
        learner = loop.learner
        self._batches = tracer.make_batches(
            self.thread_count, loop.largest * loop.strata, is_guided=self.settings.is_guided,
            records=learner is not None,
        )
        if loop.tiles and not tracer.is_linked(self._batches[0]):
            if learner is not None:
                learner.rehearse()
            tracer.warm_up(self._batches[0])
        loop.ready()

    def _next_task(self) -> Task | None:
        loop = self._loop
        with loop.changed:
            while not loop.has_task and self._busy and not self._stop:
                loop.changed.wait(0.5)
            if self._stop or not loop.has_task:
                return None
            self._busy += 1
            return loop.take()

    def _work(self, batch: Batch) -> None:
        loop = self._loop
        try:
            while (task := self._next_task()) is not None:
                unit = loop.unit(task)
                if self.tracer.trace_unit(batch, unit, self._stop_flag):
                    records = batch.take_records() if loop.records(unit.arm) else None
                    with loop.film_lock:
                        loop.keep(task, unit, batch.film, batch.unit_costs, records)
                    with loop.changed:
                        is_waiting = loop.finish(task)
                    if is_waiting:
                        # One thread only: the others find no task.
                        loop.begin_next(self._statistics_of_iterations(), is_stopped=self._stop)
                with loop.changed:
                    self._busy -= 1
                    loop.changed.notify_all()
        except BaseException:
            self.stop()
            raise
