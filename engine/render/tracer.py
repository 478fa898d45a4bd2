# SPDX-License-Identifier: GPL-3.0-or-later
"""The path tracer: kernels and memory for `trace_rounds`, and what it needs of scene, settings and guidance."""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from engine.builder.clearance import clear_distance
from engine.builder.data_passes import build_data_view
from engine.builder.light_clusters import possible_clusters
from engine.builder.scene import Scene
from engine.guiding.fields.cells.field import no_cells
from engine.guiding.fields.roulette.field import no_roulette_field
from engine.guiding.fields.table import no_table
from engine.guiding.fields.vmm.field import no_field
from engine.guiding.models.candidate_model import CandidateModel
from engine.guiding.models.predictors import unlearned_model
from engine.guiding.policy.guidance import Guidance
from engine.render.batch import LANES_AMONG_STRANDS, Arm, Batch
from engine.render.node_rays import LinkedNodeRays
from engine.render.photon_maps import NO_PHOTONS
from engine.render.photon_tracing import PhotonTracing, room_for_photons
from engine.render.python_stages import python_stages
from engine.render.scene_header import lights_of, scene_header
from engine.render.unit_header import unit_header
from engine.ris.orca import no_allocation
from engine.runtime.jit import BoundKernel, in_python
from engine.runtime.stage_table import StageTable
from engine.settings import RenderSettings
from engine.spectral.tables import no_spectral_tables, tables_for
from engine.state.camera import CAMERA_CLEAR, CAMERA_LENS_RADIUS
from engine.state.film import PLAIN_LAYOUT, FilmLayout
from engine.state.lanes import LANE_COUNT, RGB
from engine.state.lights import no_selection
from engine.state.photons import PhotonMap
from engine.state.shaders import MODE_CLOSURES, MODE_NO_REFLECTIVE_CAUSTICS, MODE_NO_REFRACTIVE_CAUSTICS
from engine.state.unit import ALL_STRATA, BRIDGE, CHALLENGER, CURRENT, PLAIN, Unit
from engine.wavefront.columns import (
    SCENE_HAS_EMITTERS,
    SCENE_HAS_ROUNDS,
    SCENE_IS_SPECTRAL,
    SCENE_SHIFTS_SHADING,
    UNIT_FOLLOWS,
    UNIT_IS_GUIDED,
    UNIT_PATH_COUNT,
    UNIT_PREDICTS,
    UNIT_RECORD_THRESHOLD,
    UNIT_SAMPLE_FIRST,
    UNIT_SHOWS_BACKGROUND,
    UNIT_SPLITS_LIGHT,
    UNIT_STRATA,
    UNIT_STRATUM,
    UNIT_USE_DENOISING,
    UNIT_USE_FEATURES,
    UNIT_USE_OCCLUSION,
    UNIT_USES_CACHE,
)
from engine.wavefront.options import make_guiding_options, make_options
from engine.wavefront.stages import STAGES, Loop, stage_arguments
from engine.wavefront.trace_rounds import trace_rounds
from engine.wavefront.work import NoModel, RadianceView, SceneView, UnitView

#: By which units' costs are compared: a thread's own time, which no other program lengthens, where it is fine.
_IS_FINE = time.get_clock_info("thread_time").resolution <= 1e-5
_UNIT_CLOCK: Callable[[], float] = time.thread_time if _IS_FINE else time.perf_counter
#: Entries of the unit's header that are for paths of the picture alone.
_OF_NO_FOLLOWER = [
    UNIT_RECORD_THRESHOLD, UNIT_IS_GUIDED, UNIT_USE_FEATURES, UNIT_USE_DENOISING, UNIT_SPLITS_LIGHT, UNIT_USE_OCCLUSION,
    UNIT_SHOWS_BACKGROUND, UNIT_PREDICTS, UNIT_USES_CACHE,
]  # fmt: skip


def _with_clearance(scene: Scene) -> np.ndarray:
    """The camera's numbers, and how far around it no medium begins or ends; one that moves has no such place,
    nor have places that are baked.
    """
    camera = scene.camera
    if not scene.media.has_inside.any() or len(camera.motion) > 1 or scene.description.bake is not None:
        return camera.real
    real = camera.real.copy()
    real[CAMERA_CLEAR] = clear_distance(camera.motion[0, [3, 7, 11]], scene.geometry, scene.media.has_inside)
    return real


def _view_of(scene: Scene, settings: RenderSettings, layout: FilmLayout) -> SceneView:
    """The scene with these settings as kernels read it."""
    description = scene.description
    options = make_options(
        settings, description.frame.exposure, description.passes.occlusion_distance, description.fast_gi
    )
    return SceneView(
        scene_header(scene, settings), _with_clearance(scene), scene.camera.motion, scene.camera.shutter,
        scene.camera.filter,
        tables_for(description.to_xyz) if settings.channel_count > RGB else no_spectral_tables(),
        scene.geometry, scene.shaders, scene.tables, lights_of(scene), scene.media.arrays,
        build_data_view(scene, layout.data.options), scene.bake, scene.casters, NO_PHOTONS,
        scene.local_scenes.handles, options,
    )  # fmt: skip


def _link_of(model: CandidateModel, batch: Batch) -> object:
    """What decides whether a stage that asks a model can ask another."""
    return model.kernel, model.memory(None)._numba_type_, batch.work.candidates._numba_type_


def _lanes_in_flight(view: SceneView, arm: Arm) -> int:
    """How many paths a unit has at once."""
    has_few = view.header[SCENE_HAS_ROUNDS] != 0 and arm.guidance is None
    return LANES_AMONG_STRANDS if has_few else LANE_COUNT


def _radiance_of(guidance: Guidance | None, nothing: RadianceView) -> RadianceView:
    """What predicts radiance, and where paths end; `nothing` is that of who knows nothing."""
    names = [name for name in RadianceView._fields if name not in RadianceView._opaque]
    learned = {} if guidance is None else {name: getattr(guidance, name) for name in names}
    radiance = nothing._replace(**{name: one for name, one in learned.items() if one is not None})
    if radiance._numba_type_ != nothing._numba_type_:
        raise TypeError("what was learned is not of the shape that kernels were compiled for")
    return radiance


class Tracer:
    """Path tracing; shared by all threads, changed by none while they trace.

    It stays for many renders: kernels stay linked and threads keep their memory while what they work on has the same
    types. Between renders it takes another scene or other settings. Between iterations `guidance` is replaced by what
    has been learned; None: nothing yet, or nothing asked for.
    """

    def __init__(self, scene: Scene, settings: RenderSettings, layout: FilmLayout = PLAIN_LAYOUT) -> None:
        self._batches: list[Batch] = []
        self._batch_key: object = None
        #: What the kernels in the table are linked for: types, and which stages have something to do.
        self._linked_for: object = None
        self._python_loop = in_python(trace_rounds)
        self._node_rays, self._photons = LinkedNodeRays(), PhotonTracing()
        self.take(scene, settings, layout)

    def take(self, scene: Scene, settings: RenderSettings, layout: FilmLayout = PLAIN_LAYOUT) -> None:
        """Be ready to trace this scene with these settings; what was learned is forgotten."""
        channel_count = settings.channel_count
        self.seed = settings.seed
        self.divides_wavelengths = settings.u_dimension == "WAVELENGTH"
        self.layout = layout
        self._traces = scene.traces
        self.mode = MODE_CLOSURES | (0 if settings.use_caustics_reflective else MODE_NO_REFLECTIVE_CAUSTICS)
        self.mode |= 0 if settings.use_caustics_refractive else MODE_NO_REFRACTIVE_CAUSTICS
        self.view = _view_of(scene, settings, layout)
        #: Called with (kind, paths or shadow rays, lanes, count) before rays are traced; for benchmarks.
        self.ray_observer: Callable[..., None] | None = None
        nothing = np.zeros(1, np.float32)
        self._nothing_learned = {
            "field": no_field(), "allocation": no_allocation(), "probability": nothing, "light_share": nothing,
            "benefit": nothing,
        }
        self._photons.take(scene, settings)
        self._no_radiance = RadianceView(
            no_table(channel_count), NoModel(np.zeros(1, np.uint8)), no_cells(), no_roulette_field()
        )
        self._settings = settings
        #: Of the type that will weigh candidates, where that is known before anything is learned.
        self._unlearned = unlearned_model(settings)
        self._arms: dict[int, Arm] = {}
        self.guidance: Guidance | None = None
        if self._linked_for is None:
            self._unlink()

    def follow(self, guidance: Guidance, arm: int = CURRENT) -> None:
        """Have units that are traced from now on go by what was learned: all of them, or those of the arm BRIDGE."""
        if arm == BRIDGE:
            self._arms = {**self._arms, BRIDGE: self._make_arm(guidance)}
        else:
            self.guidance = guidance

    def _unlink(self) -> None:
        """A new table: the types of the stages' arguments follow from scene and settings."""
        self.stages = StageTable(STAGES)
        self._compiled_loop: BoundKernel | None = None
        self._photons.unlink()
        #: What `ask_model` is linked for.
        self._asked: object = None

    def let_go(self) -> None:
        """Hold on to no scene and to nothing learned, for their memory; `take` comes before the next unit."""
        if hasattr(self, "view"):
            self.guidance = None
            self._arms = {}
            del self.view

    def make_batches(self, count: int, pixel_count: int, *, is_guided: bool, records: bool) -> list[Batch]:
        """Memory of so many threads: what they had in the last render, where it fits this one.

        Parameters
        ----------
        pixel_count : int
            Most rows that a unit has on the film.
        is_guided, records : bool
            Whether paths are guided, and recorded.
        """
        settings, shaders = self._settings, self.view.shaders
        room: dict[str, Any] = {"is_guided": is_guided, "records": records, **room_for_photons(self.view.casters)}
        key = (count, pixel_count, self.layout, settings, *room.values())
        if key != self._batch_key:
            self._batches, self._batch_key = [], None
            self._batches = [Batch(shaders, pixel_count, settings, self.layout, **room) for _ in range(count)]
            self._batch_key = key
        self._node_rays.ready(self._batches, self.view, self._traces)
        return self._batches

    def is_linked(self, batch: Batch) -> bool:
        """Whether the kernels are those for this render, from an earlier one; if not, `warm_up` links them."""
        loop = self._rehearsed_loop(batch)
        types = (bundle._numba_type_ for bundle in (loop.scene, loop.unit, loop.guidance, loop.radiance, loop.work))
        needed = *types, *stage_arguments(loop)
        if needed != self._linked_for:
            self._linked_for = needed
            self._unlink()
        return self._compiled_loop is not None and all(
            self._asked == _link_of(model, batch) for model in self._models
        )

    @property
    def _models(self) -> list[CandidateModel]:
        """What may be asked about candidates in this render, as far as that is known."""
        found = [self._unlearned, *(arm.model for arm in self._arms.values())]
        return [model for model in found if model is not None]

    def _link_model(self, model: CandidateModel, batch: Batch) -> None:
        """Have a stage ask a model. The last render's threads have ended, and this one's have not had one to ask."""
        if self._asked == _link_of(model, batch):
            return
        self._asked = _link_of(model, batch)
        if not self.stages.plug("ask_model", model.kernel, model.memory(None), batch.work.candidates, 0, 0):
            self._compiled_loop = None

    @property
    def light_clusters(self) -> np.ndarray | None:
        """See `possible_clusters`."""
        return possible_clusters(self.view.lights) if self.view.header[SCENE_HAS_EMITTERS] else None

    @property
    def guidance(self) -> Guidance | None:
        """What paths are guided by."""
        return self._guidance

    @guidance.setter
    def guidance(self, guidance: Guidance | None) -> None:
        self._guidance = guidance
        selection = no_selection() if guidance is None or guidance.lights is None else guidance.lights
        self.view = self.view._replace(lights=self.view.lights._replace(selection=selection))
        challenger = guidance.challenger if guidance is not None else None
        # The cache and roulette end paths whatever guides them.
        ends_paths = guidance is not None and (guidance.uses_cache or guidance.roulette_field is not None)
        plain = guidance.plain() if guidance is not None and ends_paths else None
        bridge = {BRIDGE: self._arms[BRIDGE]} if guidance is not None and BRIDGE in self._arms else {}
        self._arms = {PLAIN: self._make_arm(plain), CURRENT: self._make_arm(guidance), **bridge}
        if challenger is not None:
            self._arms[CHALLENGER] = self._make_arm(challenger)

    def _make_arm(self, guidance: Guidance | None) -> Arm:
        newest = self._guidance
        model = None if guidance is None or guidance.field is None else guidance.model
        header = unit_header(
            self.seed, self.mode, self.view, self.layout, guidance, asks_model=model is not None,
            learns_lights=newest is not None and newest.lights is not None,
            divides_wavelengths=self.divides_wavelengths,
        )
        radiance = _radiance_of(guidance, self._no_radiance)
        if guidance is None or guidance.field is None:
            options = make_guiding_options(self._settings, candidate_count=1)
            return Arm(guidance, {"options": options, **self._nothing_learned}, radiance, self.view, header)
        guidance.check_regions()
        options = make_guiding_options(
            self._settings,
            candidate_count=guidance.candidate_count,
            predicts_color=guidance.table is not None or guidance.model is not None,
            probes_only=guidance.probes_only,
        )
        learned = {
            "options": options, "field": guidance.field, "allocation": guidance.allocation,
            "probability": guidance.probability, "light_share": guidance.light_share, "benefit": guidance.benefit,
        }
        if guidance.model is not None and self._batches:
            self._link_model(guidance.model, self._batches[0])
        return Arm(guidance, learned, radiance, self.view, header, model)

    def warm_up(self, batch: Batch) -> None:
        """Load (or compile) every kernel that this scene can need."""
        arguments = self._rehearsed_arguments(batch)
        is_linked = self.stages.link(stage_arguments(self._rehearsed_loop(batch)))
        if hasattr(trace_rounds, "overloads"):
            loop = BoundKernel(trace_rounds)
            loop.bind(*arguments)
            if is_linked:
                self._compiled_loop = loop
                self._photons.link(arguments)
        for model in self._models:
            self._link_model(model, batch)

    def _rehearsed_loop(self, batch: Batch) -> Loop:
        """The same, and what decides which stages may be called."""
        _, scene, unit, guidance, radiance, work, _ = self._rehearsed_arguments(batch)
        return Loop(
            scene, unit, guidance, radiance, work, is_guided=batch.is_guided, records=batch.has_records,
            uses_cache=batch.uses_cache, predicts=batch.predicts,
        )

    def _rehearsed_arguments(self, batch: Batch) -> tuple:
        """What `trace_rounds` takes, of the types that it takes in this render."""
        unit = Unit(np.zeros((1, 2), np.int32), np.zeros(1, np.int32), 0, 1, arm=PLAIN)
        return self._arguments(self.stages, batch, unit, np.zeros(1, np.int32))

    def look_at(self, batch: Batch, pixel: tuple[int, int], path_count: int) -> np.ndarray:
        """Bring paths through a pixel's centre to the first surface and ready it for guiding, as a round would.

        For showing what was learned: `batch.work` then holds the lanes' points and closures, `batch.guidance` their
        guides. Lanes are guided wherever there is something to guide them by, whatever the region's guiding
        probability.

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
        unit = Unit(np.array([pixel], np.int32), np.zeros(1, np.int32), 0, path_count, arm=CURRENT)
        stages, view, unit_view, guidance, _, b, _ = self._arguments(self.stages, batch, unit, np.zeros(1, np.int32))
        batch.begin()
        unit_view.header[UNIT_RECORD_THRESHOLD] = 0  # Nothing of these paths is recorded.
        pinhole = view.camera.copy()
        pinhole[CAMERA_LENS_RADIUS] = 0.0
        scene = view._replace(camera=pinhole, pixel_filter=np.zeros_like(view.pixel_filter))
        stages.init_from_camera(scene, unit_view, b, b.free)
        stages.play_roulette(scene, unit_view, b, b.active)
        stages.intersect_closest(scene, unit_view, b, b.traced)
        stages.prepare_surface(scene, unit_view, b, b.traced)
        if view.header[SCENE_HAS_ROUNDS]:
            stages.prepare_rounds(scene, unit_view, b, b.surface)
        surface_count = int(b.surface.count[0])
        stages.evaluate_shaders(
            view.shaders, view.geometry, view.tables, b.points, b.shaded, b.surface.lanes, surface_count, b.registers,
            self.mode,
        )
        if view.header[SCENE_SHIFTS_SHADING]:
            stages.shift_terminator(scene, unit_view, b, b.surface)
        if view.header[SCENE_IS_SPECTRAL]:
            stages.upsample_closures(scene, unit_view, b, b.surface)
        if unit_view.header[UNIT_IS_GUIDED]:
            sure = guidance._replace(
                probability=np.ones_like(guidance.probability), light_share=np.ones_like(guidance.light_share)
            )
            stages.prepare_guides(scene, unit_view, sure, b, b.surface)
        return b.surface.lanes[:surface_count].copy()

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
        take, trace = partial(self._arguments, self.stages, batch, stop=stop), self._compiled_loop or self._python_loop
        photons = self._photons.map_of(unit.sample_first, batch, take, trace)
        if photons is None:
            return False
        batch.begin(_lanes_in_flight(self.view, self._arms[unit.arm]))
        started, cost_from = time.perf_counter(), _UNIT_CLOCK()
        model = self._arms[unit.arm].model
        ask = None if model is None else model.ask_elsewhere
        if self.ray_observer is None and ask is None and self._compiled_loop is not None:
            loop: Callable[..., Any] = self._compiled_loop
            arguments = self._arguments(self.stages, batch, unit, stop, photons)
        else:
            loop = self._python_loop
            arguments = self._arguments(python_stages(self.stages, self.ray_observer, ask), batch, unit, stop, photons)
        is_finished = loop(*arguments)
        if is_finished and self.layout.has_catchers:
            batch.begin_followers()
            arguments[2].header[_OF_NO_FOLLOWER] = 0
            arguments[2].header[UNIT_FOLLOWS] = 1
            is_finished = loop(*arguments)
        seconds = time.perf_counter() - started
        # Who answers elsewhere does so in threads of its own.
        cost = seconds if ask is not None else _UNIT_CLOCK() - cost_from
        batch.count(unit, seconds, cost, is_finished=bool(is_finished))
        return bool(is_finished)

    def _arguments(
        self, stages: Any, batch: Batch, unit: Unit, stop: np.ndarray, photons: PhotonMap | None = None
    ) -> tuple:
        """What `trace_rounds` takes."""
        arm = self._arms[unit.arm]
        guidance = arm.guidance
        weights = batch.no_weight
        if guidance is not None and guidance.pixel_weight is not None:
            weights = guidance.pixel_weight[unit.film_index]
            if unit.stratum == ALL_STRATA:
                weights = np.repeat(weights, unit.strata)
        header = arm.header.copy()
        header[UNIT_SAMPLE_FIRST], header[UNIT_PATH_COUNT] = unit.sample_first, unit.path_count
        header[UNIT_STRATUM], header[UNIT_STRATA] = unit.stratum, unit.strata
        view = UnitView(header, unit.pixels, weights, batch.film)
        view_of_arm = arm.view
        if photons is not None and photons is not view_of_arm.photons:
            view_of_arm = view_of_arm._replace(photons=photons)
        return (
            stages, view_of_arm, view, batch.follow(arm), batch.predict_by(arm), batch.work, stop
        )  # fmt: skip
