# SPDX-License-Identifier: GPL-3.0-or-later
"""One render's threads: they take tasks from its course, trace them, and bring what comes of them."""

from __future__ import annotations

import threading
import time
from concurrent.futures import ThreadPoolExecutor
from typing import Protocol

import numpy as np

from engine.guiding.policy.cache_learning import CacheLearner
from engine.guiding.policy.guidance import Guidance
from engine.guiding.policy.learning import Learner
from engine.guiding.policy.request import NOTHING_ASKED, LearningRequest
from engine.guiding.policy.unguided_learning import UnguidedLearner
from engine.render.batch import Batch, Statistics
from engine.render.compile_progress import FirstCalls
from engine.render.course import Course, CourseJob
from engine.render.film import Film
from engine.render.report import Progress
from engine.render.schedule import Task
from engine.render.tracer import Tracer
from engine.scene.description import Frame, Notice
from engine.settings import RenderSettings

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

    @property
    def learner(self) -> Learner | CacheLearner | UnguidedLearner | None:
        """What learns."""

    @property
    def guidance(self) -> Guidance | None:
        """What the newest samples went by."""

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


class Job(CourseJob):
    """One render.

    Parameters
    ----------
    tracer : Tracer
        That has taken the scene.
    frame : Frame
    film : Film
    settings : RenderSettings
    thread_count : int
    request : LearningRequest
    samples : int, optional
        Where to stop, before the number of the settings.
    """

    def __init__(
        self, tracer: Tracer, frame: Frame, film: Film, settings: RenderSettings, thread_count: int,
        request: LearningRequest = NOTHING_ASKED, samples: int | None = None,
    ) -> None:
        self.tracer, self.film, self.settings = tracer, film, settings
        self.thread_count = thread_count
        self.prepare_seconds = 0.0
        self.render_seconds = 0.0
        self._course = Course(
            frame, film, settings, thread_count, tracer.follow, tracer.light_clusters, request, samples
        )
        self._busy = 0
        #: Read by kernels: not 0 ends them after the round in work.
        self._stop_flag = np.zeros(1, np.int32)
        self._batches: list[Batch] = []
        self._pool = ThreadPoolExecutor(thread_count, thread_name_prefix="trace")
        self._futures: list = []
        self._created = time.perf_counter()
        self._first_calls = FirstCalls()

    @property
    def notices(self) -> list[Notice]:
        """What users should know of how it went."""
        return self._course.notices

    def start(self) -> None:
        """Begin: one thread readies the kernels on a single path, then all trace."""
        self._futures = [self._pool.submit(self._prepare)]

    def stop(self) -> None:
        """Ask all threads to stop at the next stage."""
        with self._course.changed:
            self._stop_flag[0] = 1
            self._course.changed.notify_all()

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
    def has_paths(self) -> bool:
        """Whether there is anything to show; it may be a part of the image."""
        return self._course.has_paths

    @property
    def is_preparing(self) -> bool:
        """Whether kernels are still being loaded, which cannot be interrupted where one must be compiled."""
        return not self._course.has_begun

    def join(self) -> None:
        """Wait for the threads to end; but once stopped, not for one that readies kernels and will notice later."""
        self._pool.shutdown(wait=not (self._stop and self.is_preparing))
        self._course.ended_by = self._course.ended_by or "SAMPLES"
        self.render_seconds = self._course.elapsed

    def statistics(self) -> Statistics:
        """Sum over threads."""
        total = Statistics()
        for batch in self._batches:
            total.add(batch.statistics)
        return total

    def progress(self) -> Progress:
        """Where it stands now."""
        if self.is_preparing:
            elapsed = time.perf_counter() - self._created
            message = self._first_calls.message(_PREPARING)
            return Progress(0.0, 0, self._course.samples, elapsed, None, 0.0, message)
        return self._course.progress(sum(sum(batch.statistics.rays.values()) for batch in self._batches))

    def _prepare(self) -> None:
        tracer, course = self.tracer, self._course
        learner = course.learner
        self._batches = tracer.make_batches(
            self.thread_count, course.largest * course.strata, is_guided=self.settings.is_guided,
            records=learner is not None,
        )
        if course.tiles and not tracer.is_linked(self._batches[0]):
            if learner is not None:
                learner.rehearse()
            tracer.warm_up(self._batches[0])
        course.ready()
        self.prepare_seconds = time.perf_counter() - self._created
        if self._stop:
            return
        course.begin()
        self._futures += [self._pool.submit(self._work, batch) for batch in self._batches]

    def _next_task(self) -> Task | None:
        course = self._course
        with course.changed:
            while not course.has_task and self._busy and not self._stop:
                course.changed.wait(0.5)
            if self._stop or not course.has_task:
                return None
            self._busy += 1
            return course.take()

    def _work(self, batch: Batch) -> None:
        course = self._course
        try:
            while (task := self._next_task()) is not None:
                unit = course.unit(task)
                if self.tracer.trace_unit(batch, unit, self._stop_flag):
                    records = batch.take_records() if course.records(unit.arm) else None
                    with course.film_lock:
                        course.keep(task, unit, batch.film, batch.unit_costs, records)
                    with course.changed:
                        is_waiting = course.finish(task)
                    if is_waiting:
                        # One thread only: the others find no task.
                        course.begin_next(self.statistics(), is_stopped=self._stop)
                with course.changed:
                    self._busy -= 1
                    course.changed.notify_all()
        except BaseException:
            self.stop()
            raise
