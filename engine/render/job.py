# SPDX-License-Identifier: GPL-3.0-or-later
"""One render's threads: they take tasks from its schedule, trace them, and put them on the film."""

from __future__ import annotations

import threading
import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Protocol

import numpy as np

from engine.guiding.models.record_sink import RecordSink
from engine.guiding.models.source_model import TrainedSource
from engine.guiding.policy import trial
from engine.guiding.policy.cache_learning import CacheLearner
from engine.guiding.policy.costs import IterationCosts
from engine.guiding.policy.guidance import Guidance
from engine.guiding.policy.iterations import LearningRests, iteration_weight
from engine.guiding.policy.learning import Learner
from engine.guiding.policy.trial import Part
from engine.guiding.policy.unguided_learning import UnguidedLearner
from engine.guiding.records.of_unit import UnitRecords
from engine.guiding.saved.learned import LearnedField
from engine.render.adaptive import ActivePixels
from engine.render.batch import Batch, Statistics
from engine.render.film import Film
from engine.render.report import ENDINGS, Progress
from engine.render.schedule import LARGEST_TASK_SAMPLES, Iterations, PlainSchedule, Schedule, Steps, Task
from engine.render.strata import StrataFilm, StrataSchedule
from engine.render.tiles import FrameTiles, Tile
from engine.render.tracer import Tracer
from engine.scene.description import Frame, Notice
from engine.settings import RenderSettings
from engine.state.unit import ALL_STRATA, CURRENT, PLAIN, Unit

_PREPARING = "Preparing kernels"


class AnyJob(Protocol):
    """One render, whoever does it: this process's threads, or a cluster's workers. Methods are as `Job` has them."""

    film: Film
    film_lock: threading.Lock
    learner: Learner | CacheLearner | UnguidedLearner | None
    #: Of `ENDINGS`, once it is known.
    ended_by: str
    prepare_seconds: float
    render_seconds: float

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


class Job:
    """One render.

    Parameters
    ----------
    tracer : Tracer
        That has taken the scene.
    frame : Frame
    film : Film
    settings : RenderSettings
    thread_count : int
    source, sink, start : optional
        See `Session.render`.
    keeps : bool
        Whether what is learned outlives the render.
    samples : int, optional
        Where to stop, before the number of the settings.
    first : int
        Sample to begin with, of a render that learns nothing. From a later one than 0 on, all are one task a tile.
    """

    def __init__(
        self, tracer: Tracer, frame: Frame, film: Film, settings: RenderSettings, thread_count: int,
        source: TrainedSource | None = None, sink: RecordSink | None = None, start: LearnedField | None = None,
        keeps: bool = False, samples: int | None = None, first: int = 0,
    ) -> None:
        self.samples = samples = settings.samples if samples is None else min(samples, settings.samples)
        self.tracer, self.film, self.settings = tracer, film, settings
        self.thread_count = thread_count
        self.film_lock = threading.Lock()
        #: Of `ENDINGS`, once it is known.
        self.ended_by = ""
        self.has_image = False
        self.prepare_seconds = 0.0
        self.render_seconds = 0.0
        self.learner: Learner | CacheLearner | UnguidedLearner | None = None
        tiles = FrameTiles(frame)
        self._tiles: Sequence[Tile] = tiles
        self._strata = max(settings.strata, 1)
        #: Of samples that lie in all of u.
        self._whole = ALL_STRATA if self._strata > 1 else 0
        #: Which pixels go on, where there is a noise threshold.
        self._active: ActivePixels | None = None
        if settings.use_adaptive_sampling:
            self._active = ActivePixels(settings, film, frame.exposure, tiles)
        self._schedule: Schedule
        self._iterations: Iterations | None = None
        self._steps: Steps | None = None
        self._largest, pixel_count = tiles.largest, tiles.pixel_count
        light_clusters = tracer.light_clusters if settings.learns_lights else None
        if settings.is_guided:
            self.learner = Learner(
                settings, thread_count, pixel_count, tiles.largest, source, sink, start, keeps, light_clusters
            )
        elif settings.radiance_cache != "OFF":
            self.learner = CacheLearner(settings, pixel_count, tiles.largest)
        elif settings.learns_roulette or light_clusters is not None:
            self.learner = UnguidedLearner(settings, pixel_count, tiles.largest, light_clusters)
        if self.learner is not None:
            strata = StrataSchedule(settings, self._strata) if self._strata > 1 else None
            self._schedule = self._iterations = Iterations(samples, strata)
            self._iterations.begin(self.learner.parts, len(self._tiles))
        else:
            self._go_on_plainly(first, samples - first if first else 1)
        self._units: dict[int, list[UnitRecords]] = {}
        #: What the last learning has left, while iterations go by that nothing is learned from; None while none do.
        self._learned: Guidance | None = None
        self._rests = LearningRests(pixel_count)
        self._before = Statistics()
        self._queue_changed = threading.Condition()
        self._busy = 0
        #: Read by kernels: not 0 ends them after the round in work.
        self._stop_flag = np.zeros(1, np.int32)
        self._batches: list[Batch] = []
        self._pool = ThreadPoolExecutor(thread_count, thread_name_prefix="trace")
        self._futures: list = []
        self._finished_paths = 0
        self._total_paths = float(pixel_count * (samples - first))
        self._sample = 0
        self._fraction = 0.0
        self._created = time.perf_counter()
        self._render_start: float | None = None

    @property
    def guidance(self) -> Guidance | None:
        """What the newest iteration goes by; None of an unguided render."""
        return self.tracer.guidance

    @property
    def notices(self) -> list[Notice]:
        """What users should know of how it went: what the learner says."""
        return [] if self.learner is None else self.learner.notices

    def start(self) -> None:
        """Begin: one thread readies the kernels on a single path, then all trace."""
        self._futures = [self._pool.submit(self._prepare)]

    def stop(self) -> None:
        """Ask all threads to stop at the next stage."""
        with self._queue_changed:
            self._stop_flag[0] = 1
            self._queue_changed.notify_all()

    @property
    def _stop(self) -> bool:
        """True once `stop` was called."""
        return bool(self._stop_flag[0])

    @property
    def _is_learning(self) -> bool:
        """Whether the render goes in iterations: it is guided, and guiding has not been given up."""
        return self._schedule is self._iterations

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
        return self._finished_paths > 0

    @property
    def is_preparing(self) -> bool:
        """Whether kernels are still being loaded, which cannot be interrupted where one must be compiled."""
        return self._render_start is None

    def join(self) -> None:
        """Wait for the threads to end; but once stopped, not for one that readies kernels and will notice later."""
        self._pool.shutdown(wait=not (self._stop and self.is_preparing))
        self.ended_by = self.ended_by or "SAMPLES"
        if self._render_start is not None:
            self.render_seconds = time.perf_counter() - self._render_start

    def statistics(self) -> Statistics:
        """Sum over threads."""
        total = Statistics()
        for batch in self._batches:
            total.add(batch.statistics)
        return total

    def progress(self) -> Progress:
        """Where it stands now. With a noise threshold nobody knows how long it takes before the first look."""
        now = time.perf_counter()
        elapsed = now - (self._render_start or self._created)
        samples, limit, active = self.samples, self.settings.time_limit, self._active
        if self._render_start is None:
            return Progress(0.0, 0, samples, elapsed, None, 0.0, _PREPARING)
        fraction = min(self._finished_paths / max(self._total_paths, 1.0), 1.0)
        sample = int(fraction * samples) if active is None else self._sample
        remaining = None
        if fraction > 0.0 and (active is None or active.has_looked):
            remaining = elapsed * (1.0 - fraction) / fraction
        if limit:
            remaining = min(max(limit - elapsed, 0.0), remaining if remaining is not None else limit)
            fraction = max(fraction, min(elapsed / limit, 1.0))
        # What is expected after a look may be more than what was before.
        self._fraction = max(self._fraction, fraction)
        rays = sum(sum(batch.statistics.rays.values()) for batch in self._batches)
        message = ENDINGS[self.ended_by] if self.ended_by else ""
        share = None
        if active is not None and active.has_looked:
            share = active.count / max(self.film.width * self.film.height, 1)
        return Progress(
            self._fraction, sample, samples, elapsed, remaining, rays / max(elapsed, 1e-6), message, share
        )

    def _prepare(self) -> None:
        tracer = self.tracer
        self._batches = tracer.make_batches(
            self.thread_count, self._largest * self._strata, is_guided=self.settings.is_guided,
            records=self.learner is not None,
        )
        if self._tiles and not tracer.is_linked(self._batches[0]):
            if self.learner is not None:
                self.learner.rehearse()
            tracer.warm_up(self._batches[0])
        if self.learner is not None:
            self.tracer.guidance = self.learner.first()
        self.prepare_seconds = time.perf_counter() - self._created
        if self._stop:
            return
        self._render_start = time.perf_counter()
        self._futures += [self._pool.submit(self._work, batch) for batch in self._batches]

    def _time_is_up(self) -> bool:
        limit = self.settings.time_limit
        assert self._render_start is not None
        return bool(limit and self.has_image and time.perf_counter() - self._render_start >= limit)

    def _next_task(self) -> Task | None:
        with self._queue_changed:
            while not self._schedule.has_task and self._busy and not self._stop:
                self._queue_changed.wait(0.5)
            if self._time_is_up() and self._schedule.has_task:
                self.ended_by = "TIME_LIMIT"
                self._schedule.clear()
            if self._stop or not self._schedule.has_task:
                return None
            self._busy += 1
            return self._schedule.take()

    def _work(self, batch: Batch) -> None:
        try:
            while (task := self._next_task()) is not None:
                pixels, film_index = self._tiles[task.tile]
                unit = Unit(pixels, film_index, *task.part, task.stratum, self._strata)
                if self.tracer.trace_unit(batch, unit, self._stop_flag):
                    self._keep(batch, task, unit)
                    with self._queue_changed:
                        is_waiting = self._schedule.finish(task)
                    if is_waiting:
                        # One thread only: the others find no task.
                        self._begin_next()
                with self._queue_changed:
                    self._busy -= 1
                    if not task.is_first or not self._schedule.lacks_first_tasks:
                        self.has_image = True
                    self._queue_changed.notify_all()
        except BaseException:
            self.stop()
            raise

    def _keep(self, batch: Batch, task: Task, unit: Unit) -> None:
        """Put a finished unit on the film, and what it recorded aside."""
        weight = 1.0
        if self.learner is not None:
            weight = iteration_weight(task.weighs_as, self.settings, self.learner.known_samples)
            if unit.arm == PLAIN:
                weight *= trial.PLAIN_WEIGHT
            elif self._is_learning:
                self._units.setdefault(task.tile, []).append(batch.take_records())
        with self.film_lock:
            sums = batch.film
            if isinstance(self.film, StrataFilm):
                sums = self.film.merge_stratum(unit.film_index, sums, weight, unit.stratum)
            else:
                self.film.merge(unit.film_index, sums, weight)
            self._finished_paths += len(unit.pixels) * unit.sample_count
            self._sample = max(self._sample, unit.sample_first + unit.sample_count)
            if self.learner is not None:
                self.learner.compare(unit, sums, batch.unit_costs)

    def _go_on_plainly(self, first: int = 0, count: int = 1) -> None:
        """Render the rest unguided, from a sample on, in tasks of which the first has `count` samples."""
        samples, active = self.samples, self._active
        if active is None:
            self._schedule = PlainSchedule(len(self._tiles), samples, first, count, self._whole)
        else:
            self._schedule = self._steps = Steps(samples, active.rule.next_look, first, count, self._whole)
            self._steps.begin(len(self._tiles))

    def _begin_next(self) -> None:
        """After the last unit of an iteration or a step: look at the picture, learn, and begin the next.

        The other threads wait meanwhile.
        """
        if self._is_learning:
            self._finish_iteration()
            return
        steps, active = self._steps, self._active
        assert steps is not None and active is not None
        if steps.is_last or self._look(steps.next_sample):
            return
        self._tiles = active.tiles
        with self._queue_changed:
            steps.begin(len(self._tiles))

    def _look(self, samples: int) -> bool:
        """Drop the pixels that have converged, if it is time to look; True if there are no others."""
        active = self._active
        if active is None or not active.is_due(samples):
            return False
        active.look(samples)
        self._total_paths = self._finished_paths + active.expected_paths
        if active.count == 0:
            self.ended_by = "NOISE_THRESHOLD"
        return active.count == 0

    def _finish_iteration(self) -> None:
        """After the last unit of an iteration."""
        learner, iterations = self.learner, self._iterations
        assert learner is not None and iterations is not None and self._render_start is not None
        samples = iterations.next_sample
        following = iterations.plan(time.perf_counter() - self._render_start)
        time_is_up = self._time_is_up()
        if following is not None and time_is_up:
            self.ended_by = "TIME_LIMIT"
        is_last = following is None or time_is_up or self._look(samples)
        has_rested = self._learned is not None
        if self._stop or (is_last and (has_rested or not learner.wants_last)):
            return
        units = [records for tile in range(len(self._tiles)) for records in self._units[tile]]
        self._units = {}
        if is_last:
            assert isinstance(learner, Learner)
            learner.take_last(units)
            return
        assert following is not None
        costs = self._costs_since()
        if self._active is not None:
            self._tiles = self._active.tiles
            learner.narrow(self._active.count, self._active.expected_paths)
        if not has_rested:
            assert self.tracer.guidance is not None
            self.tracer.guidance = learner.learn(
                units, self.tracer.guidance.record_threshold / 2**32, self.film.sums,
                (self.film.height, self.film.width), costs, following, is_whole=iterations.is_whole,
            )
        with self._queue_changed:
            if learner.is_over:
                # Nobody waits for anybody from here on, but for a look at the picture.
                self._go_on_plainly(following[0], LARGEST_TASK_SAMPLES)
            else:
                iterations.begin(self._parts_of(*following), len(self._tiles))

    def _parts_of(self, first: int, count: int) -> list[Part]:
        """Parts of the next iteration: as the learner says, or all alike where nothing is to be learned from it."""
        assert self.learner is not None
        rested, self._learned = self._learned, None
        parts = self.learner.parts
        if rested is not None:
            self.tracer.guidance, parts = rested, [Part(first, count, CURRENT)]
        active, guidance = self._active, self.tracer.guidance
        assert guidance is not None
        if active is not None and active.has_looked and self._rests.take(active.count, count):
            self._learned = guidance
            self.tracer.guidance, parts = guidance.without_records(), [Part(first, count, CURRENT)]
        return parts

    def _costs_since(self) -> IterationCosts:
        """What the threads have counted since this was last asked."""
        total, before = self.statistics(), self._before
        self._before = total
        return IterationCosts(
            total.stage_seconds - before.stage_seconds,
            sum(total.rays.values()) - sum(before.rays.values()),
            total.path_count - before.path_count,
            total.guided_count - before.guided_count,
            total.several_count - before.several_count,
            total.several_candidate_count - before.several_candidate_count,
            total.record_drop_count - before.record_drop_count,
            total.rays["closest"] - before.rays["closest"],
        )
