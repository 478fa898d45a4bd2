# SPDX-License-Identifier: GPL-3.0-or-later
"""The path tracer: `Integrator.trace_unit` reads as the list of stages."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import Any

import numpy as np

from engine.accel import RayScratch
from engine.film import FilmTile, allocate_tile
from engine.guidance import Guidance, Predictor
from engine.guiding.vertices import (
    allocate_log,
    allocate_vertex_records,
    collect_records,
)
from engine.guiding.vmm.field import allocate_guide
from engine.jit import BoundKernel
from engine.ris.candidates import CANDIDATE_ROWS, allocate_candidates
from engine.scene.build import Scene
from engine.scene.light_arrays import HEADER_EMITTERS, HEADER_FIRST_SUN, HEADER_HITTABLE, HEADER_LAST_SUN
from engine.settings import RenderSettings
from engine.shaders.arrays import (
    MODE_CLOSURES,
    MODE_EMISSION,
    MODE_NO_REFLECTIVE_CAUSTICS,
    MODE_NO_REFRACTIVE_CAUSTICS,
    MODE_TRANSPARENCY,
    PROGRAM_EMISSION_CONSTANT,
    PROGRAM_FLAGS,
    allocate_memory,
)
from engine.state import (
    LANE_COUNT,
    allocate_closures,
    allocate_guided_lanes,
    allocate_light_samples,
    allocate_paths,
    allocate_points,
    allocate_shadow_rays,
)
from engine.wavefront.accumulate import accumulate
from engine.wavefront.draw_candidates import draw_candidates
from engine.wavefront.evaluate_shaders import evaluate_shaders
from engine.wavefront.guide_lights import guide_lights
from engine.wavefront.guide_resample import guide_resample
from engine.wavefront.init_from_camera import init_from_camera
from engine.wavefront.intersect_closest import intersect_closest
from engine.wavefront.intersect_shadow import intersect_shadow, pass_transparent
from engine.wavefront.options import make_guiding_options, make_options
from engine.wavefront.play_roulette import play_roulette
from engine.wavefront.predict_radiance import predict_by_mixture, predict_by_table
from engine.wavefront.prepare_guides import prepare_guides
from engine.wavefront.prepare_surface import prepare_surface
from engine.wavefront.sample_light import choose_lights, connect_lights
from engine.wavefront.scatter import scatter
from engine.wavefront.shade_background import fill_background, prepare_background, shade_background
from engine.wavefront.shade_emission import shade_emission
from engine.wavefront.shade_lights import shade_lights
from engine.wavefront.write_features import write_features

#: Distances of light from outside the scene [m].
_FAR = np.float32(1e30)
#: Records that a unit of work may make.
RECORD_ROWS = 1 << 15


#: Stages, those of guided renders last.
_STAGES = (
    init_from_camera,
    play_roulette,
    intersect_closest,
    shade_lights,
    prepare_surface,
    fill_background,
    prepare_background,
    shade_background,
    evaluate_shaders,
    shade_emission,
    write_features,
    choose_lights,
    connect_lights,
    intersect_shadow,
    pass_transparent,
    scatter,
    accumulate,
    prepare_guides,
    guide_lights,
    draw_candidates,
    predict_by_mixture,
    predict_by_table,
    guide_resample,
    collect_records,
)


def _bind(stage: Callable[..., Any]) -> Callable[..., Any]:
    """A stage to be called with arguments of the same types every time; a plain function as it is.

    Stages are plain where nothing is compiled, and where a process that fills the cache leaves one out.
    """
    return BoundKernel(stage) if hasattr(stage, "overloads") else stage


@dataclass(frozen=True)
class Unit:
    """A tile of pixels by a range of samples: the smallest piece of work, always done whole.

    pixels : int32 (P, 2), column and row in the full image
    film_index : int64 (P,), where they are on the film
    """

    pixels: np.ndarray
    film_index: np.ndarray
    sample_first: int
    sample_count: int


@dataclass
class Statistics:
    """Counts and times of one thread (or, added up, of all)."""

    stage_seconds: Counter[str] = field(default_factory=Counter)
    rays: Counter[str] = field(default_factory=Counter)
    path_count: int = 0
    reject_count: int = 0
    #: Vertices that were guided, those of them with several candidates, and all candidates, and theirs.
    guided_count: int = 0
    several_count: int = 0
    candidate_count: int = 0
    several_candidate_count: int = 0

    def add(self, other: Statistics) -> None:
        """Add another thread's."""
        self.stage_seconds.update(other.stage_seconds)
        self.rays.update(other.rays)
        self.path_count += other.path_count
        self.reject_count += other.reject_count
        self.guided_count += other.guided_count
        self.several_count += other.several_count
        self.candidate_count += other.candidate_count
        self.several_candidate_count += other.several_candidate_count


class Batch:
    """One thread's memory: everything a unit needs, allocated once."""

    def __init__(
        self, scene: Scene, pixel_count: int, *, use_features: bool, is_guided: bool = False, channel_count: int = 3
    ) -> None:
        lanes = LANE_COUNT
        self.paths = allocate_paths(lanes, channel_count)
        self.points = allocate_points(lanes)
        self.closures = allocate_closures(lanes, channel_count)
        self.samples = allocate_light_samples(lanes, channel_count)
        self.shadows = allocate_shadow_rays(lanes, channel_count)
        #: Points and closures of lights and of shadow rays' blockers.
        self.light_points = allocate_points(lanes)
        self.light_closures = allocate_closures(lanes, channel_count)
        self.f_cos = np.zeros((lanes, channel_count), np.float32)
        self.active, self.free, self.traced, self.surface, self.missed, self.lit, self.programs, self.pending = (
            np.zeros(lanes, np.int32) for _ in range(8)
        )
        #: Guided lanes with one candidate, and with several.
        self.single, self.several = (np.zeros(lanes, np.int32) for _ in range(2))
        self.guided = allocate_guided_lanes(lanes)
        self.log = allocate_log(lanes, use_vertices=is_guided)
        if is_guided:
            self.guide = allocate_guide(lanes)
            self.candidates = allocate_candidates(CANDIDATE_ROWS, channel_count)
            self.records = allocate_vertex_records(RECORD_ROWS, channel_count)
        #: Records of the unit in work.
        self.record_count = 0
        self._guidance: Guidance | None = None
        self.predictor: Predictor | None = None
        self.scratch = RayScratch()
        self.memory = allocate_memory(scene.shaders)
        self.film: FilmTile = allocate_tile(pixel_count, channel_count, use_features)
        self.statistics = Statistics()
        self._mark = 0.0

    def follow(self, guidance: Guidance | None) -> None:
        """Use what an iteration has learned."""
        if guidance is not self._guidance:
            self._guidance = guidance
            if guidance is not None:
                self.guiding = make_guiding_options(guidance.settings, candidate_count=guidance.candidate_count)
            make = guidance.new_predictor if guidance is not None else None
            self.predictor = make() if make is not None else None

    def begin(self) -> None:
        """Start the stage clock."""
        self._mark = time.perf_counter()

    def end(self, stage: str) -> None:
        """Charge the time since the last mark to `stage`."""
        now = time.perf_counter()
        self.statistics.stage_seconds[stage] += now - self._mark
        self._mark = now


class Integrator:
    """Path tracing of one scene with one set of settings; shared by all threads, changed by none while they trace.

    Between iterations `guidance` is replaced by what has been learned; None: nothing yet, or nothing asked for.
    """

    def __init__(self, scene: Scene, settings: RenderSettings, *, use_features: bool = False) -> None:
        self.scene = scene
        self.options = make_options(settings, scene.description.frame.exposure)
        self.seed = settings.seed
        self.guidance: Guidance | None = None
        self.use_features = use_features
        header = scene.lights.header
        self.has_emitters = bool(settings.use_nee) and int(header[HEADER_EMITTERS]) > 0
        has_suns = header[HEADER_LAST_SUN] > header[HEADER_FIRST_SUN]
        self.has_hittable_lights = bool(header[HEADER_HITTABLE] > 0 or has_suns)
        self.mode = MODE_CLOSURES
        if not settings.use_caustics_reflective:
            self.mode |= MODE_NO_REFLECTIVE_CAUSTICS
        if not settings.use_caustics_refractive:
            self.mode |= MODE_NO_REFRACTIVE_CAUSTICS
        world = scene.world_program
        self.world_is_constant = world < 0 or bool(
            scene.shaders.programs[world, PROGRAM_FLAGS] & PROGRAM_EMISSION_CONSTANT
        )
        self.world_visibility = scene.description.world.visibility if scene.description.world else 0
        #: Called with (kind, paths or shadow rays, lanes, count) before rays are traced; for benchmarks.
        self.ray_observer: Callable[..., None] | None = None
        #: Bound here, since the types of their arguments follow from scene and settings.
        self.stages = SimpleNamespace(**{stage.__name__: _bind(stage) for stage in _STAGES})

    def warm_up(
        self, batch: Batch, unit: Unit, should_stop: Callable[[], bool], rehearsal: Guidance | None = None
    ) -> None:
        """Load (or compile) every kernel this scene can need, by one path and by calls on nothing.

        `rehearsal` is any guidance with a field, if the render is guided.
        """
        observer, self.ray_observer = self.ray_observer, None
        scene, stages, b = self.scene, self.stages, batch
        embree = (scene.accelerator.handle, b.scratch.ray, b.scratch.bits, b.scratch.address)
        self.trace_unit(b, unit, should_stop)
        if self.world_is_constant:
            stages.fill_background(scene.shaders.program_values, scene.world_program, b.closures, b.missed, 0)
        else:
            stages.prepare_background(scene.world_program, b.paths, b.points, b.missed, 0)
        stages.shade_background(
            scene.lights, self.options, self.world_visibility, b.paths, b.closures, b.missed, 0, b.film,
            self.use_features,
        )
        if self.has_emitters and scene.has_transparent_shadows:
            stages.pass_transparent(
                *embree, self.options, scene.geometry, scene.shaders.programs, scene.shaders.program_values, b.paths,
                b.shadows, b.light_points, b.light_closures, b.pending, 0, False,
            )
        if rehearsal is not None:
            self._rehearse(b, rehearsal)
        b.statistics = Statistics()
        self.ray_observer = observer

    def _rehearse(self, b: Batch, guidance: Guidance) -> None:
        """Call every guided stage on no lanes."""
        stages = self.stages
        b.follow(guidance)
        stages.prepare_guides(
            b.guiding, guidance.field, guidance.allocation, guidance.probability, b.paths, b.points, b.closures,
            b.guided, b.guide, guidance.pixel_weight, b.surface, 0,
        )
        stages.guide_lights(b.guided, b.guide, b.samples, b.lit, 0)
        stages.draw_candidates(
            b.paths, b.points, b.closures, b.guided, b.guide, b.candidates, b.single, 0, 0
        )
        if guidance.table is not None:
            stages.predict_by_table(guidance.table, b.guided, b.candidates, 0)
        else:
            stages.predict_by_mixture(b.guide, b.candidates, 0)
        stages.guide_resample(
            b.guiding, self.options, b.paths, b.points, b.closures, b.guided, b.log, b.candidates, 0, 0, b.f_cos
        )
        stages.collect_records(b.log, b.paths, guidance.pixel_weight, b.active, 0, _FAR, b.records, 0)

    def trace_unit(self, batch: Batch, unit: Unit, should_stop: Callable[[], bool]) -> bool:
        """Trace all paths of a unit into `batch.film`; False if stopped midway (the film is then incomplete)."""
        scene, stages, options, b = self.scene, self.stages, self.options, batch
        paths, points, closures, film = b.paths, b.points, b.closures, b.film
        geometry, shaders, tables, lights = scene.geometry, scene.shaders, scene.tables, scene.lights
        embree = (scene.accelerator.handle, b.scratch.ray, b.scratch.bits, b.scratch.address)
        rays = b.statistics.rays
        for array in film:
            array.fill(0)
        b.free[:] = np.arange(LANE_COUNT - 1, -1, -1)
        guidance = self.guidance
        b.follow(guidance)
        is_guided = guidance is not None and guidance.field is not None
        record_threshold = guidance.record_threshold if guidance is not None else 0
        weights = guidance.pixel_weight if guidance is not None else None
        pixel_weight = weights[unit.film_index] if weights is not None else np.zeros(len(unit.pixels), np.float32)
        b.record_count = 0
        path_count = len(unit.pixels) * unit.sample_count
        next_path, active_count, free_count = 0, 0, LANE_COUNT
        b.begin()
        while not should_stop():
            next_path, active_count, free_count = stages.init_from_camera(
                scene.camera.real, scene.camera.filter, self.seed, unit.pixels, scene.description.frame.width,
                unit.sample_first, path_count, next_path, paths, b.log, record_threshold, b.active, active_count,
                b.free, free_count,
            )
            b.end("init_from_camera")
            if active_count == 0:
                b.statistics.path_count += path_count
                return True

            traced_count = stages.play_roulette(lights, options, paths, b.log, b.active, active_count, b.traced)
            b.end("play_roulette")

            if self.ray_observer:
                self.ray_observer("closest", paths, b.traced, traced_count)
            stages.intersect_closest(*embree, geometry, paths, b.traced, traced_count)
            rays["closest"] += traced_count
            b.end("intersect_closest")

            if self.has_hittable_lights:
                stages.shade_lights(lights, options, paths, b.traced, traced_count)
                b.end("shade_lights")

            surface_count, missed_count = stages.prepare_surface(
                geometry, shaders.programs, paths, points, b.traced, traced_count, b.surface, b.missed
            )
            b.end("prepare_surface")

            if missed_count:
                if self.world_is_constant:
                    stages.fill_background(
                        shaders.program_values, scene.world_program, closures, b.missed, missed_count
                    )
                else:
                    stages.prepare_background(scene.world_program, paths, points, b.missed, missed_count)
                    stages.evaluate_shaders(
                        shaders, geometry, tables, points, closures, b.missed, missed_count, b.memory, MODE_EMISSION
                    )
                stages.shade_background(
                    lights, options, self.world_visibility, paths, closures, b.missed, missed_count, film,
                    self.use_features,
                )
                b.end("shade_background")

            stages.evaluate_shaders(
                shaders, geometry, tables, points, closures, b.surface, surface_count, b.memory, self.mode
            )
            b.end("evaluate_shaders")
            stages.shade_emission(
                lights, geometry, options, paths, points, closures, b.surface, surface_count, film, self.use_features
            )
            b.end("shade_emission")
            if self.use_features:
                stages.write_features(
                    scene.camera.real, geometry, tables, shaders.program_pass_index, paths, points, closures, b.f_cos,
                    b.surface, surface_count, film,
                )
                b.end("write_features")

            if is_guided:
                stages.prepare_guides(
                    b.guiding, guidance.field, guidance.allocation, guidance.probability, paths, points,
                    closures, b.guided, b.guide, pixel_weight, b.surface, surface_count,
                )
                b.end("prepare_guides")

            if self.has_emitters:
                self._sample_lights(b, surface_count, embree)

            single_count, several_count = stages.scatter(
                options, paths, points, closures, b.guided, b.log, b.f_cos, b.surface, surface_count, b.single,
                b.several,
            )
            b.end("scatter")
            if single_count:
                self._resample(b, b.single, single_count, is_single=True)
            if several_count:
                self._resample(b, b.several, several_count, is_single=False)

            if record_threshold:
                b.record_count, _ = stages.collect_records(
                    b.log, paths, pixel_weight, b.active, active_count, _FAR, b.records, b.record_count
                )
                b.end("collect_records")
            active_count, free_count, reject_count = stages.accumulate(
                paths, b.active, active_count, b.free, free_count, film
            )
            b.statistics.reject_count += reject_count
            b.end("accumulate")
        return False

    def _sample_lights(self, b: Batch, surface_count: int, embree: tuple) -> None:
        """Next-event estimation for all shaded lanes: choose, evaluate, connect, trace."""
        scene, stages, options = self.scene, self.stages, self.options
        geometry, shaders, tables = scene.geometry, scene.shaders, scene.tables
        lit_count, program_count = stages.choose_lights(
            scene.lights, geometry, b.paths, b.points, b.closures, b.samples, b.light_points, b.surface, surface_count,
            b.lit, b.programs,
        )
        b.end("choose_lights")
        if program_count:
            stages.evaluate_shaders(
                shaders, geometry, tables, b.light_points, b.light_closures, b.programs, program_count, b.memory,
                MODE_EMISSION,
            )
            b.end("evaluate_light_shaders")
        if self.guidance is not None and self.guidance.field is not None:
            stages.guide_lights(b.guided, b.guide, b.samples, b.lit, lit_count)
            b.end("guide_lights")
        shadow_count = stages.connect_lights(
            options, tables, geometry, b.paths, b.points, b.closures, b.samples, b.light_closures, b.f_cos, b.lit,
            lit_count, b.shadows,
        )
        b.end("connect_lights")
        if self.ray_observer:
            self.ray_observer("shadow", b.shadows, b.paths, shadow_count)
        pending_count = stages.intersect_shadow(
            *embree, options, b.paths, b.shadows, shadow_count, scene.has_transparent_shadows, b.pending
        )
        b.statistics.rays["shadow"] += shadow_count
        is_evaluated = False
        while pending_count:
            b.statistics.rays["transparent_shadow"] += pending_count
            pending_count = stages.pass_transparent(
                *embree, options, geometry, shaders.programs, shaders.program_values, b.paths, b.shadows,
                b.light_points, b.light_closures, b.pending, pending_count, is_evaluated,
            )
            if pending_count:
                stages.evaluate_shaders(
                    shaders, geometry, tables, b.light_points, b.light_closures, b.pending, pending_count, b.memory,
                    MODE_TRANSPARENCY,
                )
            is_evaluated = True
        b.end("intersect_shadow")

    def _resample(self, b: Batch, lanes: np.ndarray, lane_count: int, *, is_single: bool) -> None:
        """Draw candidates for the lanes, predict what arrives along them if there are several, and pick one each."""
        guidance = self.guidance
        assert guidance is not None
        paths, candidates, options, statistics, stages = b.paths, b.candidates, b.guiding, b.statistics, self.stages
        first = 0
        while first < lane_count:
            first, vertex_count, row_count = stages.draw_candidates(
                paths, b.points, b.closures, b.guided, b.guide, candidates, lanes, first, lane_count
            )
            b.end("sample_source" if is_single else "draw_candidates")
            statistics.guided_count += vertex_count
            statistics.candidate_count += row_count
            if not is_single:
                statistics.several_count += vertex_count
                statistics.several_candidate_count += row_count
                if b.predictor is not None:
                    b.predictor.predict(
                        candidates.position, candidates.vertex, candidates.direction, row_count, candidates.radiance
                    )
                elif guidance.table is not None:
                    stages.predict_by_table(guidance.table, b.guided, candidates, row_count)
                else:
                    stages.predict_by_mixture(b.guide, candidates, row_count)
                b.end("predict_radiance")
            stages.guide_resample(
                options, self.options, paths, b.points, b.closures, b.guided, b.log, candidates,
                vertex_count, row_count, b.f_cos,
            )
            b.end("sample_source" if is_single else "guide_resample")
