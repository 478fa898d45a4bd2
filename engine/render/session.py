# SPDX-License-Identifier: GPL-3.0-or-later
"""The engine's front door: load a scene description, render it, hand out images while it goes."""

from __future__ import annotations

import functools
import os
import threading
import time
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor, wait
from dataclasses import replace
from typing import ParamSpec

from engine.builder.scene import Scene, SceneCache, build_scene, look_at
from engine.guiding.models.record_sink import RecordSink
from engine.guiding.models.report import GuidingReport
from engine.guiding.models.source_model import TrainedSource
from engine.guiding.policy.guidance import Guidance
from engine.guiding.policy.request import LearningRequest
from engine.guiding.policy.rules import RULES, Rules
from engine.guiding.policy.trial import ArmSamples
from engine.guiding.saved.learned import LearnedField
from engine.render.afterwards import Afterwards
from engine.render.batch import Statistics
from engine.render.checkpointing import Checkpointing
from engine.render.compile_progress import FirstCalls
from engine.render.denoising import Denoising
from engine.render.film import Film, Images, PassImages
from engine.render.garbage_collection import collect_nothing_while_compiling
from engine.render.job import AnyJob, Job
from engine.render.pace import FINAL, Pace
from engine.render.precompile import compile_ahead
from engine.render.report import Progress, RenderReport, RenderResult, peak_memory
from engine.render.request import RenderRequest
from engine.render.resolution import Resolution, is_spectral, resolve
from engine.render.traced import Pixels, TracedTiles, trace_tiles
from engine.render.tracer import Tracer
from engine.render.watch import watch
from engine.runtime import heap
from engine.runtime.kernel_cache import describe_kernels
from engine.runtime.kernel_cache import problem as cache_problem
from engine.scene.description import Camera, Frame, Notice, SceneDescription
from engine.scene.digest import light_digest
from engine.scene.limits import check_film, texture_memory
from engine.settings import RenderSettings
from engine.state.film import FilmLayout
from engine.state.media import MAX_MEDIA
from engine.wavefront.columns import CACHED_DEPTHS

#: Said while there is nothing to show yet.
_BUILDING = "Building the scene"
_DENOISING = "Denoising"
#: Of most passes, or nearly.
_PASS_CHANNELS = 4
_P = ParamSpec("_P")


class LoadCancelled(Exception):
    """`Session.load` was cancelled; no scene is loaded."""


def _frees(render: Callable[_P, RenderResult]) -> Callable[_P, RenderResult]:
    """A method that renders, and then gives back to the system what nobody has any more once it has returned."""

    @functools.wraps(render)
    def render_and_free(*args: _P.args, **named: _P.kwargs) -> RenderResult:
        try:
            return render(*args, **named)
        finally:
            if named.get("pace", FINAL) is FINAL:
                # Windows are rendered many times a second.
                heap.give_back()

    return render_and_free


def _cache_notices() -> list[Notice]:
    problem = cache_problem()
    return [Notice("Kernel cache", problem, "the next process compiles the kernels again")] if problem else []


def _media_notices(counted: Statistics) -> list[Notice]:
    found = []
    if counted.medium_drop_count:
        problem = f"paths were in more than {MAX_MEDIA} media at once"
        found.append(Notice("Volumes", problem, "those beyond are not there for these paths"))
    if counted.majorant_excess_count:
        problem = f"were denser than expected at {counted.majorant_excess_count} points"
        found.append(Notice("Volumes", problem, "the picture is right, and noisier there"))
    if counted.medium_reject_count:
        problem = f"were no numbers at {counted.medium_reject_count} points"
        found.append(Notice("Volumes", problem, "nothing is there"))
    if counted.tracking_end_count:
        problem = f"were too dense, or too large, for {counted.tracking_end_count} rays"
        found.append(Notice("Volumes", problem, "these rays end within them"))
    return found


class Session:
    """Renders scene descriptions with one set of settings.

    Keep the session between frames: only what changed is rebuilt.

    Parameters
    ----------
    settings : RenderSettings
    expects_moves : bool
        Whether things are moved about between renders, as in a viewport: then what has moved once costs the next move
        little, and rays a little more.
    rules : Rules
        What learning goes by.
    """

    #: Whether other machines trace.
    _on_cluster = False

    def __init__(self, settings: RenderSettings, *, expects_moves: bool = False, rules: Rules = RULES) -> None:
        collect_nothing_while_compiling()
        self.settings = settings
        self.scene: Scene | None = None
        self._rules = rules
        self._expects_moves = expects_moves
        self._cache = SceneCache(expects_moves=expects_moves)
        self._tracer: Tracer | None = None
        #: Of the scene, '' while nobody has asked.
        self._light_digest = ""
        self._build_seconds = 0.0
        self._compile_seconds = 0.0
        #: Of the next render; None: nothing of it is kept.
        self.checkpointing: Checkpointing | None = None

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
        keeps_meshes: bool = True,
    ) -> list[Notice]:
        """Build or update the scene; compile the kernels before, where they never were.

        Parameters
        ----------
        on_progress, should_cancel : callable, optional
            Called in this thread only, often.
        keeps_meshes : bool
            False where nothing like it is loaded after it: then meshes are in memory once, and the description's are
            empty afterwards.

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
        self._light_digest = ""
        if self._tracer is not None:
            self._tracer.let_go()
        samples = self.settings.samples

        start = time.perf_counter()

        def poll(message: str, fraction: float = 0.0) -> None:
            if should_cancel is not None and should_cancel():
                raise LoadCancelled
            if on_progress is not None:
                on_progress(Progress(fraction, 0, samples, time.perf_counter() - start, None, 0.0, message))

        compile_ahead(
            lambda compiling: poll(compiling.sentence, compiling.fraction), is_guided=self.settings.is_guided,
            is_spectral=is_spectral(self.settings, description),
        )
        self._compile_seconds = time.perf_counter() - start
        start = time.perf_counter()
        if not keeps_meshes and self.settings.is_guided:
            # It is asked for when what was learned is kept, and that is too late.
            self._light_digest = light_digest(description)
        first_calls = FirstCalls()
        self.scene = self._build(description, keeps_meshes, lambda: poll(first_calls.message(_BUILDING)))
        self._build_seconds = time.perf_counter() - start
        return [*self.scene.notices, *_cache_notices()]

    def look(self, camera: Camera, frame: Frame) -> None:
        """Have the loaded scene seen by another camera, or in another frame; what it lights stays as it is.

        Raises
        ------
        RuntimeError
            If no scene is loaded.
        ValueError
            As `load`.
        """
        if self.scene is None:
            raise RuntimeError("load a scene before looking at it")
        looked = look_at(self.scene, camera, frame, self.settings, self._cache)
        if looked is not None:
            self.scene = looked
            return
        digest = self._light_digest
        self.load(replace(self.scene.description, camera=camera, frame=frame))
        self._light_digest = digest

    def _build(self, description: SceneDescription, keeps_meshes: bool, poll: Callable[[], None]) -> Scene:
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
            keeps_meshes=keeps_meshes,
        )
        pool.shutdown(wait=False)
        try:
            while not wait((future,), FINAL.poll_seconds).done:
                poll()
        except BaseException:
            # The thread ends at its next check. Until then the cache is its own.
            is_abandoned.set()
            self._cache = SceneCache(expects_moves=self._expects_moves)
            raise
        return future.result()

    def _take_tracer(self, scene: Scene, settings: RenderSettings, layout: FilmLayout) -> Tracer:
        """The tracer of the last render, ready for this one; a new one for the first."""
        if self._tracer is None:
            self._tracer = Tracer(scene, settings, layout)
        else:
            self._tracer.take(scene, settings, layout)
        return self._tracer

    def close(self) -> None:
        """Free the scene, its acceleration structure and the threads' memory."""
        self.scene = self._tracer = None
        self._cache = SceneCache(expects_moves=self._expects_moves)

    @_frees
    def render(
        self,
        *,
        on_progress: Callable[[Progress], None] | None = None,
        on_image: Callable[[Images], None] | None = None,
        should_cancel: Callable[[], bool] | None = None,
        passes: Iterable[str] = ("Combined",),
        ray_observer: Callable[..., None] | None = None,
        source: TrainedSource | None = None,
        sink: RecordSink | None = None,
        start: LearnedField | None = None,
        keep: bool = False,
        pace: Pace = FINAL,
        samples: int | None = None,
        shows_cancelled: bool = True,
        one_by_one: bool = False,
    ) -> RenderResult:
        """Render the loaded scene.

        Parameters
        ----------
        on_progress, on_image, should_cancel : callable, optional
            Called in this thread only. `on_image` gets passes soon after the start and then at widening intervals; of
            a large image there may be black parts at first. After a cancel the result holds every finished unit.
            Only the result of a render that went to its end is denoised.
        passes : iterable of str
            Of `film.PASS_NAMES`, and of the scene's light groups (`light_passes.group_pass`), AOVs and mattes
            (`engine.scene.pass_names`).
        ray_observer : callable, optional
            See `Tracer.ray_observer`.
        source : TrainedSource, optional
            What directions are drawn from, instead of what the settings would have this render learn
            (`SequenceField.source`).
        sink : RecordSink, optional
            Gets what paths record, if the render is guided.
        start : LearnedField, optional
            What another render has learned. Paths are guided by it from the first sample on, and it is learned onto.
            Where lights or geometry are others by now the render starts anew, and a notice says so.
        keep : bool
            Whether the result is to hold what was learned.
        pace : Pace
            When there are images, and how often `should_cancel` is called.
        samples : int, optional
            Where to stop, before the settings' number: the first part of a render by the same settings.
        shows_cancelled : bool
            Whether the result of a cancelled render has passes, which take a moment.
        one_by_one : bool
            Whether passes are made one at a time, when they are looked up (`PassImages`), for whoever copies each.
            Those of `on_image` are then good until it returns, and each is of the samples that there are by then.

        Raises
        ------
        RuntimeError
            If no scene is loaded.
        ValueError
            If the machine cannot hold the picture's passes, or a checkpoint does not fit that is to (`Checkpointing`).
        """
        if self.scene is None:
            raise RuntimeError("load a scene before rendering")
        scene, names = self.scene, frozenset(passes)
        denoising = Denoising(self.settings, self.thread_count)
        resolution = resolve(
            self.settings, scene, names | denoising.passes, LearningRequest(source, sink, start, keep, self._rules),
            lambda: self.light_digest, samples, on_cluster=self._on_cluster,
        )
        request = resolution.request
        settings, frame = request.settings, request.frame
        afterwards = Afterwards()
        check_film(frame, Film(1, 1, request.layout).nbytes, _PASS_CHANNELS * len(names))
        begin = RenderRequest.begin if self.checkpointing is None else self.checkpointing.begin
        request, film = begin(request)
        job = self._job(scene, request, film, ray_observer)

        def images(names: frozenset[str]) -> Images:
            if one_by_one:
                return PassImages(film, names | {"Combined"}, frame.exposure, job.film_lock)
            with job.film_lock:
                return film.passes(names, exposure=frame.exposure)

        texels, most_texel_bytes = self._cache.programs.images, texture_memory(settings.texture_memory)

        def is_to_stop() -> bool:
            # Asked for often, whoever asks.
            texels.keep_within(most_texel_bytes)
            return should_cancel is not None and should_cancel()

        try:
            watch(job, lambda: images(names), on_progress, on_image, is_to_stop, pace, self.checkpointing)
        finally:
            if job.is_preparing:
                # A thread may still be at it.
                self._tracer = None
            if job.learner is not None:
                afterwards.attempt("Learning", "ending it", job.learner.close, "the picture is whole")
        result_passes: Images = {}
        if shows_cancelled or job.ended_by != "CANCEL":
            result_passes = images(names | denoising.passes)
        if denoising.is_on and job.ended_by != "CANCEL":
            if on_progress is not None:
                on_progress(replace(job.progress(), remaining=None, message=_DENOISING))
            if not denoising.run(result_passes, should_cancel, film, frame.exposure):
                job.ended_by = "CANCEL"
        if on_progress is not None:
            on_progress(replace(job.progress(), remaining=0.0))
        learner = job.learner
        learned = None
        if keep and learner is not None:
            learned = afterwards.attempt(
                "Learned field", "keeping it", lambda: learner.learned(self.light_digest), "the next render learns anew"
            )
        report = afterwards.attempt(
            "Report", "writing it", lambda: self._report(job, scene, resolution), "figures are missing"
        ) or RenderReport(sample_count=float(film.sums.count.mean()), ended_by=job.ended_by)
        report.denoise_seconds = denoising.seconds
        report.notices += [*resolution.notices, *denoising.notices, *afterwards.notices]
        for name in denoising.passes - names:
            result_passes.pop(name, None)
        return RenderResult(result_passes, report, job.guidance, learned)

    def _job(
        self, scene: Scene, request: RenderRequest, film: Film, ray_observer: Callable[..., None] | None
    ) -> AnyJob:
        """Who renders: this process's threads; see `render`."""
        tracer = self._take_tracer(scene, request.settings, film.layout)
        tracer.ray_observer = ray_observer
        return Job(tracer, request, film, self.thread_count)

    def trace_tiles(
        self, settings: RenderSettings, layout: FilmLayout, tiles: Sequence[Pixels], arm_samples: ArmSamples,
        stratum: int, guidance: Guidance | None, *, records: bool,
    ) -> tuple[TracedTiles, Statistics]:
        """Trace samples of some of the loaded scene's tiles, for whoever puts them on a film (`RenderLoop`).

        Parameters
        ----------
        settings : RenderSettings
            As the one who asks has worked them out.
        layout : FilmLayout
        tiles : int32 (P, 2) each
            Column and row of pixels in the full image.
        part, stratum
            As of a `Task`.
        guidance : Guidance or None
            What paths go by; its pixel weights are of the tiles' pixels one after the other.
        records : bool
            Whether what paths record is wanted.

        Raises
        ------
        RuntimeError
            If no scene is loaded.
        """
        if self.scene is None:
            raise RuntimeError("load a scene before rendering")
        tracer = self._take_tracer(self.scene, settings, layout)
        tracer.ray_observer = None
        return trace_tiles(tracer, settings, self.thread_count, tiles, arm_samples, stratum, guidance, records=records)

    @property
    def light_digest(self) -> str:
        """Digest of all that light depends on in the loaded scene; fields that were learned by another do not fit.

        Raises
        ------
        RuntimeError
            If no scene is loaded.
        """
        if self.scene is None:
            raise RuntimeError("load a scene before asking for its digest")
        if not self._light_digest:
            self._light_digest = light_digest(self.scene.description)
        return self._light_digest

    def _report(self, job: AnyJob, scene: Scene, resolution: Resolution) -> RenderReport:
        """What happened in a render that is over."""
        total, learner, film, settings = job.statistics(), job.learner, job.film, resolution.request.settings
        path_count = max(total.path_count, 1)
        cached_shares = tuple(total.cached_counts[depth + 1] / path_count for depth in range(CACHED_DEPTHS))
        guiding = GuidingReport(method=settings.guiding_method)
        if learner is not None:
            guiding = learner.report
            guiding.candidates_per_vertex = total.candidate_count / max(total.guided_count, 1)
            guiding.describe(dict(total.stage_seconds))
            if settings.radiance_cache != "OFF":
                guiding.describe_cache(cached_shares)
        elif settings.method.rungs:
            guiding.describe_left_out()
        guiding.describe_no_cache(resolution.cache_left_out)
        return RenderReport(
            notices=[*scene.notices, *_cache_notices(), *job.notices, *_media_notices(total)],
            build_seconds=self._build_seconds,
            compile_seconds=self._compile_seconds,
            prepare_seconds=job.prepare_seconds,
            kernels=describe_kernels(),
            render_seconds=job.render_seconds,
            sample_count=float(film.sums.count.mean()) if film.sums.count.size else 0.0,
            path_count=total.path_count,
            rays=dict(total.rays),
            stage_seconds=dict(total.stage_seconds),
            reject_count=total.reject_count,
            record_reject_count=total.record_reject_count,
            record_drop_count=total.record_drop_count,
            peak_memory=peak_memory(),
            thread_count=self.thread_count,
            cached_shares=cached_shares,
            is_spectral=settings.spectral == "ON",
            ended_by=job.ended_by,
            guiding=guiding,
            denoised_error=job.looks.denoised_error,
            denoised_look=job.looks.denoised_look,
        )
