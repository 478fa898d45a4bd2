# SPDX-License-Identifier: GPL-3.0-or-later
"""The path tracer: what `trace_rounds` needs, made from scene, settings and what has been learned."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np

from engine.accel import RayScratch
from engine.film import FilmTile, allocate_tile
from engine.guidance import Guidance
from engine.guiding.guide import allocate_guide_of, with_field
from engine.guiding.network import network_shape
from engine.guiding.network_query import no_network
from engine.guiding.perceptron import MAX_WIDTH, allocate_scratch
from engine.guiding.table import no_table
from engine.guiding.vertices import allocate_log, allocate_vertex_records, collect_records
from engine.guiding.vmm.field import no_field
from engine.jit import BoundKernel, in_python
from engine.kernels.clock import begin
from engine.ris.candidates import CANDIDATE_ROWS, allocate_candidates
from engine.ris.orca import no_allocation
from engine.scene.build import Scene
from engine.scene.camera import CAMERA_LENS_RADIUS
from engine.scene.light_arrays import HEADER_EMITTERS, HEADER_FIRST_SUN, HEADER_HITTABLE, HEADER_LAST_SUN
from engine.settings import RenderSettings
from engine.shaders.arrays import (
    MODE_CLOSURES,
    MODE_NO_REFLECTIVE_CAUSTICS,
    MODE_NO_REFRACTIVE_CAUSTICS,
    PROGRAM_EMISSION_CONSTANT,
    PROGRAM_FLAGS,
    allocate_memory,
)
from engine.spectral.tables import no_spectral_tables, tables_for
from engine.stage_table import StageTable
from engine.state import (
    LANE_COUNT,
    RGB,
    allocate_closures,
    allocate_guided_lanes,
    allocate_light_samples,
    allocate_paths,
    allocate_points,
    allocate_shadow_rays,
    as_rgb,
    value_width,
)
from engine.wavefront.accumulate import accumulate
from engine.wavefront.draw_candidates import draw_candidates
from engine.wavefront.evaluate_shaders import evaluate_shaders
from engine.wavefront.guide_lights import guide_lights
from engine.wavefront.guide_resample import guide_resample
from engine.wavefront.init_from_camera import init_from_camera
from engine.wavefront.intersect_closest import intersect_closest
from engine.wavefront.intersect_shadow import intersect_shadow, pass_transparent
from engine.wavefront.options import GuidingOptions, make_guiding_options, make_options
from engine.wavefront.play_roulette import play_roulette
from engine.wavefront.predict_radiance import blend_with_mixture, predict_radiance
from engine.wavefront.prepare_guides import prepare_guides
from engine.wavefront.prepare_surface import prepare_surface
from engine.wavefront.sample_light import choose_lights, connect_lights
from engine.wavefront.sample_source import sample_source
from engine.wavefront.scatter import scatter
from engine.wavefront.shade_background import fill_background, prepare_background, shade_background
from engine.wavefront.shade_emission import shade_emission
from engine.wavefront.shade_lights import shade_lights
from engine.wavefront.trace_rounds import FAR, trace_rounds
from engine.wavefront.upsample import upsample_closures, upsample_emission, upsample_lights
from engine.wavefront.write_features import write_features
from engine.wavefront.write_guiding import write_guiding
from engine.work import (
    ALL_STRATA,
    CANDIDATES,
    CHALLENGER,
    CLOCK_ENTRIES,
    CLOSEST_RAYS,
    COUNT_WIDTH,
    CURRENT,
    FREE,
    GUIDED_VERTICES,
    LANE_LISTS,
    PLAIN,
    RECORDS,
    REJECTS,
    RESAMPLED_CANDIDATES,
    RESAMPLED_VERTICES,
    SCENE_HANDLE,
    SCENE_HAS_EMITTERS,
    SCENE_HAS_HITTABLE_LIGHTS,
    SCENE_HAS_TRANSPARENT_SHADOWS,
    SCENE_HEADER_WIDTH,
    SCENE_IS_SPECTRAL,
    SCENE_WIDTH,
    SCENE_WORLD_IS_CONSTANT,
    SCENE_WORLD_PROGRAM,
    SCENE_WORLD_VISIBILITY,
    SHADOW_RAYS,
    TRANSPARENT_SHADOW_RAYS,
    UNIT_DIVIDES_WAVELENGTHS,
    UNIT_HEADER_WIDTH,
    UNIT_IS_GUIDED,
    UNIT_PATH_COUNT,
    UNIT_RECORD_THRESHOLD,
    UNIT_SAMPLE_FIRST,
    UNIT_SEED,
    UNIT_SHADER_MODE,
    UNIT_STRATA,
    UNIT_STRATUM,
    UNIT_USE_FEATURES,
    GuidanceView,
    SceneView,
    Unit,
    UnitCosts,
    UnitView,
    Work,
)

#: Records that a unit of work may make.
RECORD_ROWS = 1 << 15

#: Stages and how many int64 they return.
_STAGES: dict[str, tuple[Callable[..., Any], int]] = {
    "init_from_camera": (init_from_camera, 3),
    "play_roulette": (play_roulette, 1),
    "intersect_closest": (intersect_closest, 0),
    "shade_lights": (shade_lights, 0),
    "prepare_surface": (prepare_surface, 2),
    "fill_background": (fill_background, 0),
    "prepare_background": (prepare_background, 0),
    "shade_background": (shade_background, 0),
    "evaluate_shaders": (evaluate_shaders, 0),
    "upsample_emission": (upsample_emission, 0),
    "upsample_lights": (upsample_lights, 0),
    "upsample_closures": (upsample_closures, 0),
    "shade_emission": (shade_emission, 0),
    "write_features": (write_features, 0),
    "choose_lights": (choose_lights, 2),
    "connect_lights": (connect_lights, 1),
    "intersect_shadow": (intersect_shadow, 1),
    "pass_transparent": (pass_transparent, 1),
    "scatter": (scatter, 2),
    "accumulate": (accumulate, 3),
    "prepare_guides": (prepare_guides, 0),
    "write_guiding": (write_guiding, 0),
    "guide_lights": (guide_lights, 0),
    "draw_candidates": (draw_candidates, 3),
    "predict_radiance": (predict_radiance, 0),
    "blend_with_mixture": (blend_with_mixture, 0),
    "guide_resample": (guide_resample, 0),
    "sample_source": (sample_source, 0),
    "collect_records": (collect_records, 2),
}


class _Arm(NamedTuple):
    """One way that units of an iteration are rendered."""

    guidance: Guidance | None
    view: GuidanceView
    options: GuidingOptions


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
        self, scene: Scene, pixel_count: int, settings: RenderSettings, *, use_features: bool, is_guided: bool = False
    ) -> None:
        lanes, channel_count = LANE_COUNT, settings.channel_count
        closures, light_closures = allocate_closures(lanes, channel_count), allocate_closures(lanes, channel_count)
        self._scratch = RayScratch()
        self.records = allocate_vertex_records(RECORD_ROWS if is_guided else 1, channel_count)
        self.work = Work(
            counts=np.zeros(COUNT_WIDTH, np.int64),
            clock=np.zeros(len(CLOCK_ENTRIES) + 1, np.int64),
            ray=self._scratch.ray,
            ray_bits=self._scratch.bits,
            ray_address=np.array([self._scratch.address], np.int64),
            registers=allocate_memory(scene.shaders),
            **{name: np.zeros(lanes, np.int32) for name in LANE_LISTS},
            f_cos=np.zeros((lanes, value_width(channel_count)), np.float32),
            latent=np.zeros((2, MAX_WIDTH), np.float32),
            hidden=allocate_scratch(MAX_WIDTH),
            paths=allocate_paths(lanes, channel_count),
            points=allocate_points(lanes),
            closures=closures,
            shaded=as_rgb(closures),
            samples=allocate_light_samples(lanes, channel_count),
            shadows=allocate_shadow_rays(lanes, channel_count),
            light_points=allocate_points(lanes),
            light_closures=light_closures,
            light_shaded=as_rgb(light_closures),
            guided=allocate_guided_lanes(lanes),
            log=allocate_log(lanes, use_vertices=is_guided),
            guide=allocate_guide_of(settings, lanes if is_guided else 1),
            candidates=allocate_candidates(CANDIDATE_ROWS if is_guided else 1, channel_count),
            records=self.records,
        )
        self.film: FilmTile = allocate_tile(pixel_count, RGB, use_features)
        self.no_weight = np.zeros(pixel_count, np.float32)
        self.statistics = Statistics()
        #: Of the last unit: time [s], rays, guided vertices, and candidates of vertices with several.
        self.unit_costs = UnitCosts()
        self._guidance: Guidance | None = None

    @property
    def record_count(self) -> int:
        """Records of the unit in work."""
        return int(self.work.counts[RECORDS])

    def follow(self, guidance: Guidance | None) -> None:
        """Draw directions from what an iteration has learned."""
        if guidance is not self._guidance:
            self._guidance = guidance
            if guidance is not None:
                self.work = self.work._replace(guide=with_field(self.work.guide, guidance.source))

    def begin(self) -> None:
        """All lanes free, nothing counted, the film black."""
        work = self.work
        for array in self.film:
            array.fill(0)
        work.free[:] = np.arange(LANE_COUNT - 1, -1, -1)
        work.counts[:] = 0
        work.counts[FREE] = LANE_COUNT
        work.clock[:] = 0
        # No lane is guided, whatever the last unit was.
        work.guided.rough_share[:] = 0.0
        work.samples.guide_pdf[:] = 0.0
        work.samples.bsdf_share[:] = work.samples.weight[:] = 1.0
        begin(work.clock)

    def count(self, seconds: float, path_count: int) -> None:
        """Add what the unit counted to the statistics; it took so many seconds."""
        statistics, counts, clock = self.statistics, self.work.counts.tolist(), self.work.clock[:-1]
        per_tick = seconds / max(int(clock.sum()), 1)
        self.unit_costs = UnitCosts(
            seconds,
            counts[CLOSEST_RAYS] + counts[SHADOW_RAYS],
            counts[GUIDED_VERTICES],
            counts[RESAMPLED_CANDIDATES],
        )
        for entry, ticks in zip(CLOCK_ENTRIES, clock.tolist(), strict=True):
            if ticks:
                statistics.stage_seconds[entry] += ticks * per_tick
        statistics.rays["closest"] += counts[CLOSEST_RAYS]
        statistics.rays["shadow"] += counts[SHADOW_RAYS]
        statistics.rays["transparent_shadow"] += counts[TRANSPARENT_SHADOW_RAYS]
        statistics.path_count += path_count
        statistics.reject_count += counts[REJECTS]
        statistics.guided_count += counts[GUIDED_VERTICES]
        statistics.several_count += counts[RESAMPLED_VERTICES]
        statistics.candidate_count += counts[CANDIDATES]
        statistics.several_candidate_count += counts[RESAMPLED_CANDIDATES]


class Integrator:
    """Path tracing of one scene with one set of settings; shared by all threads, changed by none while they trace.

    Between iterations `guidance` is replaced by what has been learned; None: nothing yet, or nothing asked for.
    """

    def __init__(self, scene: Scene, settings: RenderSettings, *, use_features: bool = False) -> None:
        channel_count = settings.channel_count
        self.scene = scene
        self.options = make_options(settings, scene.description.frame.exposure)
        self.seed = settings.seed
        self.divides_wavelengths = settings.u_dimension == "WAVELENGTH"
        self.use_features = use_features
        header = scene.lights.header
        has_suns = header[HEADER_LAST_SUN] > header[HEADER_FIRST_SUN]
        self.mode = MODE_CLOSURES
        if not settings.use_caustics_reflective:
            self.mode |= MODE_NO_REFLECTIVE_CAUSTICS
        if not settings.use_caustics_refractive:
            self.mode |= MODE_NO_REFRACTIVE_CAUSTICS
        world = scene.world_program
        world_is_constant = world < 0 or bool(scene.shaders.programs[world, PROGRAM_FLAGS] & PROGRAM_EMISSION_CONSTANT)
        numbers = np.zeros(SCENE_HEADER_WIDTH, np.int64)
        numbers[SCENE_HANDLE] = scene.accelerator.handle
        numbers[SCENE_WIDTH] = scene.description.frame.width
        numbers[SCENE_WORLD_PROGRAM] = world
        numbers[SCENE_WORLD_VISIBILITY] = scene.description.world.visibility if scene.description.world else 0
        numbers[SCENE_WORLD_IS_CONSTANT] = world_is_constant
        numbers[SCENE_HAS_EMITTERS] = bool(settings.use_nee) and int(header[HEADER_EMITTERS]) > 0
        numbers[SCENE_HAS_HITTABLE_LIGHTS] = bool(header[HEADER_HITTABLE] > 0 or has_suns)
        numbers[SCENE_HAS_TRANSPARENT_SHADOWS] = scene.has_transparent_shadows
        numbers[SCENE_IS_SPECTRAL] = channel_count > RGB
        self.view = SceneView(
            numbers, scene.camera.real, scene.camera.motion, scene.camera.shutter, scene.camera.filter,
            tables_for(scene.description.to_xyz) if channel_count > RGB else no_spectral_tables(), scene.geometry,
            scene.shaders, scene.tables, scene.lights,
        )
        #: Called with (kind, paths or shadow rays, lanes, count) before rays are traced; for benchmarks.
        self.ray_observer: Callable[..., None] | None = None
        #: Made here, since the types of the stages' arguments follow from scene and settings.
        self.stages = StageTable(_STAGES)
        self._compiled_loop: BoundKernel | None = None
        self._python_loop = in_python(trace_rounds)
        nothing = np.zeros(1, np.float32)
        self._no_guidance = GuidanceView(
            no_field(), no_table(channel_count), no_network(network_shape(settings)),
            no_allocation(), nothing, nothing, nothing,
        )
        self._settings = settings
        self.guidance: Guidance | None = None

    @property
    def guidance(self) -> Guidance | None:
        """What paths are guided by."""
        return self._guidance

    @guidance.setter
    def guidance(self, guidance: Guidance | None) -> None:
        self._guidance = guidance
        challenger = guidance.challenger if guidance is not None else None
        self._arms = {PLAIN: self._make_arm(None), CURRENT: self._make_arm(guidance)}
        if challenger is not None:
            self._arms[CHALLENGER] = self._make_arm(challenger)

    def _make_arm(self, guidance: Guidance | None) -> _Arm:
        if guidance is None or guidance.field is None:
            options = make_guiding_options(self._settings, candidate_count=1)
            return _Arm(guidance, self._no_guidance, options)
        assert guidance.allocation is not None
        assert guidance.probability is not None and guidance.light_share is not None
        assert guidance.benefit is not None
        table = guidance.table if guidance.table is not None else self._no_guidance.table
        network = guidance.network if guidance.network is not None else self._no_guidance.network
        view = GuidanceView(
            guidance.field, table, network, guidance.allocation, guidance.probability, guidance.light_share,
            guidance.benefit,
        )
        if view._numba_type_ != self._no_guidance._numba_type_:
            raise TypeError("what was learned is not of the shape that kernels were compiled for")
        options = make_guiding_options(
            self._settings,
            candidate_count=guidance.candidate_count,
            predicts_color=guidance.table is not None or guidance.network is not None,
            probes_only=guidance.probes_only,
        )
        return _Arm(guidance, view, options)

    def warm_up(self, batch: Batch, unit: Unit, stop: np.ndarray, rehearsal: Guidance | None = None) -> None:
        """Load (or compile) every kernel this scene can need, by one path and by calls on nothing.

        `rehearsal` is any guidance with a field, if the render is guided.
        """
        observer, self.ray_observer = self.ray_observer, None
        view, stages, options, b = self.view, self.stages, self.options, batch.work
        self.trace_unit(batch, unit, stop)
        world, shaders = view.header[SCENE_WORLD_PROGRAM], view.shaders
        if view.header[SCENE_WORLD_IS_CONSTANT]:
            stages.fill_background(shaders.program_values, world, b.shaded, b.missed, 0)
        else:
            stages.prepare_background(world, b.paths, b.points, b.missed, 0)
        if view.header[SCENE_IS_SPECTRAL]:
            stages.upsample_emission(
                view.spectrum, shaders.program_temperature, world, b.paths, b.points, b.closures, b.missed, 0
            )
            stages.upsample_lights(view.spectrum, b.paths, b.samples, b.lit, 0)
        stages.shade_background(
            view.lights, view.spectrum, options, view.header[SCENE_WORLD_VISIBILITY], b.paths, b.closures, b.missed, 0,
            batch.film, self.use_features,
        )
        if view.header[SCENE_HAS_EMITTERS] and view.header[SCENE_HAS_TRANSPARENT_SHADOWS]:
            stages.pass_transparent(
                view.header[SCENE_HANDLE], b.ray, b.ray_bits, b.ray_address[0], options, view.spectrum, view.geometry,
                shaders.programs, shaders.program_values, b.paths, b.shadows, b.light_points, b.light_shaded,
                b.pending, 0, False,
            )
        if rehearsal is not None:
            self._rehearse(batch, rehearsal)
        loop = BoundKernel(trace_rounds) if hasattr(trace_rounds, "overloads") else None
        if loop is not None:
            loop.bind(*self._arguments(stages, batch, unit, stop))
            if stages.link():
                self._compiled_loop = loop
        batch.statistics = Statistics()
        self.ray_observer = observer

    def _rehearse(self, batch: Batch, guidance: Guidance) -> None:
        """Call every guided stage on no lanes."""
        self.guidance = guidance
        stages, view, options, b = self.stages, self.view, self.options, batch.work
        _, learned, guiding_options = self._arms[CURRENT]
        stages.prepare_guides(
            guiding_options, learned.field, learned.allocation, learned.probability, learned.light_share, b.paths,
            b.points, b.closures, b.guided, b.guide, b.samples, b.log, batch.no_weight, b.surface, 0,
        )
        if self.use_features:
            stages.write_guiding(learned.benefit, b.paths, b.guided, b.surface, 0, batch.film)
        if view.header[SCENE_HAS_EMITTERS]:
            stages.guide_lights(b.guided, b.guide, b.samples, b.lit, 0)
        stages.draw_candidates(b.paths, b.points, b.closures, b.guided, b.guide, b.candidates, b.single, 0, 0)
        stages.predict_radiance(
            learned.table, learned.network, b.latent, b.hidden, b.guide, b.guided, b.candidates, 0
        )
        stages.blend_with_mixture(b.guide, b.candidates, 0)
        stages.guide_resample(
            guiding_options, options, b.paths, b.points, b.closures, b.guided, b.guide, b.samples, b.log,
            batch.no_weight, b.candidates, 0, 0, b.f_cos,
        )
        stages.sample_source(
            options, b.paths, b.points, b.closures, b.guided, b.guide, b.samples, b.log, batch.no_weight, b.candidates,
            b.single, 0, b.f_cos,
        )
        stages.collect_records(b.log, b.paths, batch.no_weight, b.active, 0, FAR, b.records, 0)
        self.guidance = None

    def look_at(self, batch: Batch, pixel: tuple[int, int], path_count: int) -> np.ndarray:
        """Bring paths through a pixel's centre to the first surface and ready it for guiding, as a round would.

        For showing what was learned: `batch.work` then holds the lanes' points, closures and guides. Lanes are guided
        wherever there is something to guide them by, whatever the region's guiding probability.

        Parameters
        ----------
        batch : Batch, made for guided rendering
        pixel : (int, int)
            Column and row in the full image, row 0 at the bottom.
        path_count : int
            Lanes that look the field up, each with random numbers of its own; at most LANE_COUNT.

        Returns
        -------
        int32 (surface_count,)
            Lanes that met a surface; those that can be guided have `batch.work.guided.rough_share` above 0.
        """
        batch.follow(self.guidance)
        batch.begin()
        view, stages, b = self.view, self.stages, batch.work
        _, learned, guiding_options = self._arms[CURRENT]
        pinhole = view.camera.copy()
        pinhole[CAMERA_LENS_RADIUS] = 0.0
        _, active_count, _ = stages.init_from_camera(
            pinhole, view.camera_motion, view.shutter, view.spectrum, np.zeros_like(view.pixel_filter), self.seed,
            np.array([pixel], np.int32), view.header[SCENE_WIDTH], 0, 1, 0, 0, path_count, 0, b.paths, b.log, 0,
            b.active, 0, b.free, LANE_COUNT,
        )
        traced_count = stages.play_roulette(view.lights, self.options, b.paths, b.log, b.active, active_count, b.traced)
        stages.intersect_closest(
            view.header[SCENE_HANDLE], b.ray, b.ray_bits, b.ray_address[0], view.geometry, b.paths, b.traced,
            traced_count,
        )
        surface_count, _ = stages.prepare_surface(
            view.geometry, view.shaders.programs, b.paths, b.points, b.traced, traced_count, b.surface, b.missed
        )
        stages.evaluate_shaders(
            view.shaders, view.geometry, view.tables, b.points, b.shaded, b.surface, surface_count, b.registers,
            self.mode,
        )
        if view.header[SCENE_IS_SPECTRAL]:
            stages.upsample_closures(
                view.spectrum, view.shaders.program_dispersion, b.paths, b.points, b.closures, b.surface, surface_count
            )
        if self.guidance is not None and self.guidance.field is not None:
            stages.prepare_guides(
                guiding_options, learned.field, learned.allocation, np.ones_like(learned.probability),
                np.ones_like(learned.light_share), b.paths, b.points, b.closures, b.guided, b.guide, b.samples, b.log,
                batch.no_weight, b.surface, surface_count,
            )
        return b.surface[:surface_count].copy()

    def trace_unit(self, batch: Batch, unit: Unit, stop: np.ndarray) -> bool:
        """Trace all paths of a unit into `batch.film`.

        Parameters
        ----------
        stop : int32 (1,)
            Set to anything but 0, from any thread, it ends the unit after the round in work.

        Returns
        -------
        bool
            False if it was stopped; the film is then incomplete.
        """
        batch.follow(self._arms[unit.arm].guidance)
        batch.begin()
        started = time.perf_counter()
        if self.ray_observer is None and self._compiled_loop is not None:
            is_finished = self._compiled_loop(*self._arguments(self.stages, batch, unit, stop))
        else:
            is_finished = self._python_loop(*self._arguments(self._python_stages(), batch, unit, stop))
        batch.count(time.perf_counter() - started, len(unit.pixels) * unit.sample_count if is_finished else 0)
        return bool(is_finished)

    def _arguments(self, stages: Any, batch: Batch, unit: Unit, stop: np.ndarray) -> tuple:
        """What `trace_rounds` takes."""
        guidance, learned, guiding_options = self._arms[unit.arm]
        weights = batch.no_weight
        if guidance is not None and guidance.pixel_weight is not None:
            weights = guidance.pixel_weight[unit.film_index]
            if unit.stratum == ALL_STRATA:
                weights = np.repeat(weights, unit.strata)
        header = np.zeros(UNIT_HEADER_WIDTH, np.int64)
        header[UNIT_SEED] = self.seed
        header[UNIT_SAMPLE_FIRST] = unit.sample_first
        header[UNIT_PATH_COUNT] = len(unit.pixels) * unit.sample_count
        header[UNIT_RECORD_THRESHOLD] = guidance.record_threshold if guidance is not None else 0
        header[UNIT_IS_GUIDED] = guidance is not None and guidance.field is not None
        header[UNIT_SHADER_MODE] = self.mode
        header[UNIT_USE_FEATURES] = self.use_features
        header[UNIT_STRATUM], header[UNIT_STRATA] = unit.stratum, unit.strata
        header[UNIT_DIVIDES_WAVELENGTHS] = self.divides_wavelengths
        view = UnitView(header, unit.pixels, weights, batch.film)
        return (
            stages, self.view, self.options, guiding_options, learned, view, batch.work, stop
        )  # fmt: skip

    def _python_stages(self) -> SimpleNamespace:
        """The stages for a loop in Python, with an observer of rays if there is one."""
        stages = self.stages.as_dict()
        observer = self.ray_observer
        if observer is not None:
            closest, shadow = stages["intersect_closest"], stages["intersect_shadow"]

            def intersect_closest(*arguments: Any) -> None:
                observer("closest", *arguments[5:8])
                closest(*arguments)

            def intersect_shadow(*arguments: Any) -> int:
                observer("shadow", arguments[6], arguments[5], arguments[7])
                return shadow(*arguments)

            stages |= {"intersect_closest": intersect_closest, "intersect_shadow": intersect_shadow}
        return SimpleNamespace(**stages)
