# SPDX-License-Identifier: GPL-3.0-or-later
"""The engine's front door: load a scene description, render it, hand out images while it goes."""

from __future__ import annotations

import os
import sys
import threading
import time
from collections import deque
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor, wait
from dataclasses import dataclass, field, replace

import numpy as np

from engine.film import FEATURE_PASSES, Film
from engine.guidance import Guidance
from engine.guiding import trial
from engine.guiding.report import GuidingReport
from engine.guiding.sequence_field import with_sequence_u
from engine.guiding.source_model import TrainedSource
from engine.guiding.trial import Part
from engine.guiding.vertices import VertexRecords
from engine.kernel_cache import problem as cache_problem
from engine.learning import IterationCosts, Learner, iteration_lengths, iteration_weight
from engine.precompile import compile_ahead
from engine.scene.build import Scene, SceneCache, build_scene
from engine.scene.description import Frame, Notice, SceneDescription
from engine.settings import RenderSettings
from engine.strata import StrataFilm, StrataSchedule, strata_count
from engine.wavefront.integrator import Batch, Integrator, Statistics
from engine.work import ALL_STRATA, CURRENT, PLAIN, Unit

try:
    import resource
except ImportError:  # Windows
    resource = None  # type: ignore[assignment]

#: Side of a tile [pixels].
TILE_SIZE = 32
#: Samples of a tile's successive units grow to this: small first for an early image, large later to keep lanes full.
LARGEST_UNIT_SAMPLES = 64
#: A tile's successive units grow by this factor: the first should show soon, and each costs a start and an end with few
#: paths in flight.
UNIT_GROWTH = 4
#: Said while there is nothing to show yet.
_COMPILING = "Compiling kernels (once, takes about a minute)"
_BUILDING = "Building the scene"
_PREPARING = "Preparing kernels"
#: How often the main thread looks for a cancel [s].
_POLL_SECONDS = 0.05
#: Time until the first image, from there to the second, and the growth of that interval.
_FIRST_IMAGE_SECONDS = 0.1
_IMAGE_INTERVAL_SECONDS = 0.5
_IMAGE_INTERVAL_GROWTH = 1.6
_LONGEST_IMAGE_INTERVAL = 20.0


class LoadCancelled(Exception):
    """`Session.load` was cancelled; no scene is loaded."""


@dataclass(frozen=True)
class Progress:
    """Where a render stands. `remaining` is in seconds, None while unknown."""

    fraction: float
    sample: int
    samples: int
    elapsed: float
    remaining: float | None
    rays_per_second: float
    message: str


@dataclass
class RenderReport:
    """What happened, for logs and benchmarks; times in seconds, memory in bytes."""

    notices: list[Notice] = field(default_factory=list)
    build_seconds: float = 0.0
    compile_seconds: float = 0.0  # kernels, the first time ever
    prepare_seconds: float = 0.0  # kernels: loading from the cache
    render_seconds: float = 0.0
    sample_count: float = 0.0  # mean per pixel
    path_count: int = 0
    rays: dict[str, int] = field(default_factory=dict)
    stage_seconds: dict[str, float] = field(default_factory=dict)  # summed over threads
    reject_count: int = 0
    peak_memory: int = 0
    thread_count: int = 1
    is_spectral: bool = False  # paths had wavelengths
    cancelled: bool = False
    guiding: GuidingReport = field(default_factory=GuidingReport)


@dataclass
class RenderResult:
    """passes : dict of float32 (height, width, channels), row 0 at the bottom.

    guidance : Guidance or None
        What the last iteration went by; None of an unguided render.
    """

    passes: dict[str, np.ndarray]
    report: RenderReport
    guidance: Guidance | None = None


def peak_memory() -> int:
    """Largest resident memory of this process so far [bytes]; 0 where the system does not tell."""
    if resource is None:
        return 0
    usage = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return usage if sys.platform == "darwin" else usage * 1024


def _cache_notices() -> list[Notice]:
    problem = cache_problem()
    return [Notice("Kernel cache", problem, "the next process compiles the kernels again")] if problem else []


def _sample_ranges(samples: int, first: int = 0, count: int = 1) -> list[tuple[int, int]]:
    """(first, count) of a tile's successive units, from a first one of so many samples on."""
    ranges = []
    while first < samples:
        count = min(count, samples - first)
        ranges.append((first, count))
        first += count
        count = min(UNIT_GROWTH * count, LARGEST_UNIT_SAMPLES)
    return ranges


def _tiles(frame: Frame) -> list[tuple[np.ndarray, np.ndarray]]:
    """Pixels (column, row in the full image) and film indices of each tile of the region."""
    x0, y0, x1, y1 = frame.region
    width = x1 - x0
    tiles = []
    for top in range(y0, y1, TILE_SIZE):
        for left in range(x0, x1, TILE_SIZE):
            rows, columns = np.mgrid[top : min(top + TILE_SIZE, y1), left : min(left + TILE_SIZE, x1)]
            pixels = np.ascontiguousarray(np.stack([columns.ravel(), rows.ravel()], axis=1), np.int32)
            tiles.append((pixels, ((rows - y0) * width + (columns - x0)).ravel()))
    return tiles


def _is_spectral(settings: RenderSettings, description: SceneDescription) -> bool:
    """Whether paths have wavelengths."""
    return settings.spectral == "ON" or (settings.spectral == "AUTO" and description.has_dispersion)


def _with_u(
    settings: RenderSettings, description: SceneDescription, source: TrainedSource | None = None
) -> RenderSettings:
    """Settings in which `u_dimension` is what the scene has of it: without it the rest is learned sooner."""
    if source is not None:
        return with_sequence_u(settings, source.u_dimension)
    has_time = description.is_moving and settings.u_dimension in ("AUTO", "TIME")
    has_wavelength = (
        settings.spectral == "ON" and description.has_dispersion and settings.u_dimension in ("AUTO", "WAVELENGTH")
    )
    return settings.with_u("TIME" if has_time else "WAVELENGTH" if has_wavelength else "NONE")


class Session:
    """Renders scene descriptions with one set of settings.

    Keep the session between frames: only what changed is rebuilt.
    """

    def __init__(self, settings: RenderSettings) -> None:
        self.settings = settings
        self.scene: Scene | None = None
        self._cache = SceneCache()
        self._build_seconds = 0.0
        self._compile_seconds = 0.0

    @property
    def thread_count(self) -> int:
        """Threads that trace."""
        if self.settings.threads:
            return self.settings.threads
        try:
            return max(len(os.sched_getaffinity(0)), 1)
        except AttributeError:
            return os.cpu_count() or 1

    def load(
        self,
        description: SceneDescription,
        *,
        on_progress: Callable[[Progress], None] | None = None,
        should_cancel: Callable[[], bool] | None = None,
    ) -> list[Notice]:
        """Build or update the scene; compile the kernels before, where they never were.

        Parameters
        ----------
        on_progress, should_cancel : callable, optional
            Called in this thread only, often.

        Returns
        -------
        list of Notice
            Everything that will look different from what the host meant, the exporter's notices included.

        Raises
        ------
        ValueError
            Naming what in the description cannot be rendered.
        LoadCancelled
            Soon after `should_cancel()` was true.
        """
        self.scene = None
        samples = self.settings.samples

        def poll(message: str, seconds: float) -> None:
            if should_cancel is not None and should_cancel():
                raise LoadCancelled
            if on_progress is not None:
                on_progress(Progress(0.0, 0, samples, seconds, None, 0.0, message))

        start = time.perf_counter()
        compile_ahead(
            lambda seconds: poll(_COMPILING, seconds), is_guided=self.settings.is_guided,
            is_spectral=_is_spectral(self.settings, description),
        )
        self._compile_seconds = time.perf_counter() - start
        start = time.perf_counter()
        self.scene = self._build(description, lambda: poll(_BUILDING, time.perf_counter() - start))
        self._build_seconds = time.perf_counter() - start
        return [*self.scene.notices, *_cache_notices()]

    def _build(self, description: SceneDescription, poll: Callable[[], None]) -> Scene:
        """Build in a thread, so that steps of seconds do not keep a cancel waiting; `poll` raises to cancel."""
        is_abandoned = threading.Event()

        def check_cancel() -> None:
            if is_abandoned.is_set():
                raise LoadCancelled

        pool = ThreadPoolExecutor(1, thread_name_prefix="build")
        future = pool.submit(
            build_scene,
            description,
            self.settings,
            self._cache,
            threads=self.thread_count,
            check_cancel=check_cancel,
        )
        pool.shutdown(wait=False)
        try:
            while not wait((future,), _POLL_SECONDS).done:
                poll()
        except BaseException:
            # The thread ends at its next check. Until then the cache is its own.
            is_abandoned.set()
            self._cache = SceneCache()
            raise
        return future.result()

    def close(self) -> None:
        """Free the scene and its acceleration structure."""
        self.scene = None
        self._cache = SceneCache()

    def render(
        self,
        *,
        on_progress: Callable[[Progress], None] | None = None,
        on_image: Callable[[dict[str, np.ndarray]], None] | None = None,
        should_cancel: Callable[[], bool] | None = None,
        passes: Iterable[str] = ("Combined",),
        ray_observer: Callable[..., None] | None = None,
        source: TrainedSource | None = None,
    ) -> RenderResult:
        """Render the loaded scene.

        Parameters
        ----------
        on_progress, on_image, should_cancel : callable, optional
            Called in this thread only. `on_image` gets passes soon after the start and then at widening intervals; of
            a large image there may be black parts at first. After a cancel the result holds every finished unit.
        passes : iterable of str
            Of `film.PASS_NAMES`.
        ray_observer : callable, optional
            See `Integrator.ray_observer`.
        source : TrainedSource, optional
            What directions are drawn from, instead of what the settings would have this render learn
            (`SequenceField.source`).

        Raises
        ------
        RuntimeError
            If no scene is loaded.
        """
        if self.scene is None:
            raise RuntimeError("load a scene before rendering")
        scene, settings = self.scene, self.settings
        settings = replace(settings, spectral="ON" if _is_spectral(settings, scene.description) else "OFF")
        settings = _with_u(settings, scene.description, source)
        names = frozenset(passes)
        frame = scene.description.frame
        x0, y0, x1, y1 = frame.region
        use_features = bool(names & FEATURE_PASSES)
        film: Film = Film(x1 - x0, y1 - y0, use_features=use_features)
        strata = strata_count(settings, film.nbytes)
        settings = replace(settings, strata=strata)
        if strata > 1:
            film = StrataFilm(x1 - x0, y1 - y0, strata, use_features=use_features)
        integrator = Integrator(scene, settings, use_features=use_features)
        integrator.ray_observer = ray_observer
        job = _Job(scene, integrator, film, settings, self.thread_count, source)

        def images() -> dict[str, np.ndarray]:
            return film.passes(names, exposure=frame.exposure)

        started = time.perf_counter()
        next_image = _FIRST_IMAGE_SECONDS
        interval = _IMAGE_INTERVAL_SECONDS
        job.start()
        try:
            while not job.wait(_POLL_SECONDS):
                elapsed = time.perf_counter() - started
                if should_cancel is not None and should_cancel():
                    job.cancelled = True
                    job.stop()
                    if job.is_preparing:
                        break
                    continue
                if on_progress is not None:
                    on_progress(job.progress())
                if on_image is not None and job.has_paths and elapsed >= next_image:
                    with job.film_lock:
                        image = images()
                    on_image(image)
                    next_image = time.perf_counter() - started + interval
                    interval = min(interval * _IMAGE_INTERVAL_GROWTH, _LONGEST_IMAGE_INTERVAL)
        except BaseException:
            job.stop()
            raise
        finally:
            job.join()
            if job.learner is not None:
                job.learner.close()
        if on_progress is not None:
            on_progress(replace(job.progress(), remaining=0.0))
        total = job.statistics()
        guiding = GuidingReport(method=settings.guiding_method)
        if settings.guiding_method == "AUTO" and job.learner is None:
            guiding.chosen = "OFF"
            guiding.lines = ["chose to render without guiding: so few samples are over before it could pay"]
        if job.learner is not None:
            guiding = job.learner.report
            guiding.candidates_per_vertex = total.candidate_count / max(total.guided_count, 1)
            guiding.describe(dict(total.stage_seconds))
        report = RenderReport(
            notices=[*scene.notices, *_cache_notices(), *(job.learner.notices if job.learner is not None else [])],
            build_seconds=self._build_seconds,
            compile_seconds=self._compile_seconds,
            prepare_seconds=job.prepare_seconds,
            render_seconds=job.render_seconds,
            sample_count=float(film.sums.count.mean()) if film.sums.count.size else 0.0,
            path_count=total.path_count,
            rays=dict(total.rays),
            stage_seconds=dict(total.stage_seconds),
            reject_count=total.reject_count,
            peak_memory=peak_memory(),
            thread_count=self.thread_count,
            is_spectral=settings.spectral == "ON",
            cancelled=job.cancelled,
            guiding=guiding,
        )
        return RenderResult(images(), report, integrator.guidance)


class _Job:
    """One render's threads and queue. Units of one tile run one after the other, different tiles at the same time.

    A guided render goes in iterations: all tiles' units of a step, then learning, then the next step; until guiding is
    given up.
    """

    def __init__(
        self, scene: Scene, integrator: Integrator, film: Film, settings: RenderSettings, thread_count: int,
        source: TrainedSource | None = None,
    ) -> None:
        self.scene, self.integrator, self.film, self.settings = scene, integrator, film, settings
        self.thread_count = thread_count
        self.film_lock = threading.Lock()
        self.cancelled = False
        self.has_image = False
        self.prepare_seconds = 0.0
        self.render_seconds = 0.0
        self.learner: Learner | None = None
        if settings.is_guided:
            frame = scene.description.frame
            x0, y0, x1, y1 = frame.region
            self.learner = Learner(settings, thread_count, (x1 - x0) * (y1 - y0), source)
            lengths = iteration_lengths(settings.samples)
            ends = np.cumsum(lengths)
            self._ranges = [(int(end) - length, length) for end, length in zip(ends, lengths, strict=True)]
        else:
            self._ranges = _sample_ranges(settings.samples)
        #: Part of u that the iteration in work belongs to, of so many.
        self._stratum, self._strata = 0, max(settings.strata, 1)
        self._schedule: StrataSchedule | None = None
        if self._strata > 1:
            self._schedule = StrataSchedule(settings, self._strata)
            self._stratum, self._ranges = ALL_STRATA, []
            self._plan_stratum(0.0)
        self._step = 0
        self._units: dict[int, list[VertexRecords]] = {}
        self._before = Statistics()
        self._tiles = _tiles(scene.description.frame)
        self._queue = deque((tile, 0, 0) for tile in range(len(self._tiles)))
        self._unfinished_tiles = len(self._tiles)
        self._queue_changed = threading.Condition()
        self._busy = 0
        #: Read by kernels: not 0 ends them after the round in work.
        self._stop_flag = np.zeros(1, np.int32)
        self._batches: list[Batch] = []
        self._pool = ThreadPoolExecutor(thread_count, thread_name_prefix="trace")
        self._futures: list = []
        self._finished_paths = 0
        self._total_paths = sum(len(pixels) for pixels, _ in self._tiles) * settings.samples
        self._created = time.perf_counter()
        self._render_start: float | None = None

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
        return self.learner is not None and not self.learner.is_over

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
        if self._render_start is not None:
            self.render_seconds = time.perf_counter() - self._render_start

    def statistics(self) -> Statistics:
        """Sum over threads."""
        total = Statistics()
        for batch in self._batches:
            total.add(batch.statistics)
        return total

    def progress(self) -> Progress:
        """Where it stands now."""
        now = time.perf_counter()
        elapsed = now - (self._render_start or self._created)
        fraction = self._finished_paths / max(self._total_paths, 1)
        limit = self.settings.time_limit
        remaining = None
        if self._render_start is None:
            return Progress(0.0, 0, self.settings.samples, elapsed, None, 0.0, _PREPARING)
        if fraction > 0.0:
            remaining = elapsed * (1.0 - fraction) / fraction
        if limit:
            remaining = min(max(limit - elapsed, 0.0), remaining if remaining is not None else limit)
            fraction = max(fraction, min(elapsed / limit, 1.0))
        rays = sum(sum(batch.statistics.rays.values()) for batch in self._batches)
        sample = int(self._finished_paths / max(self._total_paths, 1) * self.settings.samples)
        speed = rays / max(elapsed, 1e-6)
        return Progress(min(fraction, 1.0), sample, self.settings.samples, elapsed, remaining, speed, "Rendering")

    def _prepare(self) -> None:
        largest = max((len(pixels) for pixels, _ in self._tiles), default=1)
        use_features = self.integrator.use_features
        self._batches = [
            Batch(
                self.scene, largest * self._strata, self.settings, use_features=use_features,
                is_guided=self.learner is not None,
            )
            for _ in range(self.thread_count)
        ]
        if self._tiles:
            pixels, film_index = self._tiles[len(self._tiles) // 2]
            rehearsal = self.learner.rehearse() if self.learner is not None else None
            unit = Unit(pixels[:1], film_index[:1], 0, 1)
            self.integrator.warm_up(self._batches[0], unit, self._stop_flag, rehearsal)
        if self.learner is not None:
            self.integrator.guidance = self.learner.first()
        self.prepare_seconds = time.perf_counter() - self._created
        if self._stop:
            return
        self._render_start = time.perf_counter()
        self._futures += [self._pool.submit(self._work, batch) for batch in self._batches]

    def _time_is_up(self) -> bool:
        limit = self.settings.time_limit
        assert self._render_start is not None
        return bool(limit and self.has_image and time.perf_counter() - self._render_start >= limit)

    def _next_unit(self) -> tuple[int, int, int] | None:
        with self._queue_changed:
            while not self._queue and self._busy and not self._stop:
                self._queue_changed.wait(0.5)
            if self._time_is_up():
                self._queue.clear()
            if self._stop or not self._queue:
                return None
            self._busy += 1
            return self._queue.popleft()

    def _work(self, batch: Batch) -> None:
        try:
            while (item := self._next_unit()) is not None:
                tile, step, part = item
                pixels, film_index = self._tiles[tile]
                parts = [Part(*self._ranges[step], CURRENT)]
                if self.learner is not None and self._is_learning:
                    parts = self.learner.parts
                unit = Unit(pixels, film_index, *parts[part], self._stratum, self._strata)
                if self.integrator.trace_unit(batch, unit, self._stop_flag):
                    self._keep(batch, tile, step, unit)
                    if part + 1 < len(parts):
                        self._queue_unit(tile, step, part + 1)
                    elif self._is_learning:
                        self._finish_iteration()
                    elif step + 1 < len(self._ranges):
                        self._queue_unit(tile, step + 1, 0)
                with self._queue_changed:
                    self._busy -= 1
                    if step > 0 or not any(queued_step == 0 for _, queued_step, _ in self._queue):
                        self.has_image = True
                    self._queue_changed.notify_all()
        except BaseException:
            self.stop()
            raise

    def _keep(self, batch: Batch, tile: int, step: int, unit: Unit) -> None:
        """Put a finished unit on the film, and what it recorded aside."""
        weight = 1.0
        if self.learner is not None:
            weight = iteration_weight(self._ranges[step][0], self.settings.sample_weighting)
            if unit.arm == PLAIN:
                weight *= trial.PLAIN_WEIGHT
            elif self._is_learning:
                rows = [column[: batch.record_count].copy() for column in batch.records]
                self._units.setdefault(tile, []).append(VertexRecords(*rows))
        with self.film_lock:
            sums = batch.film
            if isinstance(self.film, StrataFilm):
                sums = self.film.merge_stratum(unit.film_index, sums, weight, unit.stratum)
            else:
                self.film.merge(unit.film_index, sums, weight)
            self._finished_paths += len(unit.pixels) * unit.sample_count
            if self.learner is not None:
                self.learner.compare(unit, sums, batch.unit_costs)

    def _queue_unit(self, tile: int, step: int, part: int) -> None:
        with self._queue_changed:
            self._queue.append((tile, step, part))

    def _plan_stratum(self, seconds: float) -> None:
        """Append the next iteration, if there is one, and go to the stratum it belongs to."""
        assert self._schedule is not None
        sample = sum(self._ranges[-1]) if self._ranges else 0
        following = self._schedule.next(sample, seconds)
        if following is not None:
            self._stratum, count = following
            self._ranges.append((sample, count))

    def _finish_iteration(self) -> None:
        """After the last unit of an iteration: learn, and queue the next. The other threads wait meanwhile."""
        assert self.learner is not None
        with self._queue_changed:
            self._unfinished_tiles -= 1
            step = self._step + 1
            if self._schedule is not None and not self._unfinished_tiles:
                assert self._render_start is not None
                self._plan_stratum(time.perf_counter() - self._render_start)
            if self._unfinished_tiles or self._stop:
                return
            is_last = step == len(self._ranges) or self._time_is_up()
            if is_last and not self.learner.keeps_all_records:
                return
            # One thread only: the others see unfinished tiles.
            units = [records for tile in range(len(self._tiles)) for records in self._units[tile]]
            self._units = {}
            self._unfinished_tiles = len(self._tiles)
        assert self.integrator.guidance is not None
        recorded_share = self.integrator.guidance.record_threshold / 2**32
        if is_last:
            self.learner.keep(units, recorded_share)
            return
        total, before = self.statistics(), self._before
        self._before = total
        costs = IterationCosts(
            total.stage_seconds - before.stage_seconds,
            sum(total.rays.values()) - sum(before.rays.values()),
            total.path_count - before.path_count,
            total.guided_count - before.guided_count,
            total.several_count - before.several_count,
            total.several_candidate_count - before.several_candidate_count,
        )
        self.integrator.guidance = self.learner.learn(
            units, recorded_share, self.film, costs, next_range=self._ranges[step]
        )
        if self.learner.is_over:
            # Nobody waits for anybody from here on.
            first = self._ranges[step][0]
            self._ranges[step:] = _sample_ranges(self.settings.samples, first, LARGEST_UNIT_SAMPLES)
            self._stratum = ALL_STRATA if self._schedule is not None else 0
        with self._queue_changed:
            self._step = step
            self._queue.extend((tile, step, 0) for tile in range(len(self._tiles)))
