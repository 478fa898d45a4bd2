# SPDX-License-Identifier: GPL-3.0-or-later
"""One thread's memory for tracing, and what it has counted."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from engine.accel.scratch import RayScratch
from engine.guiding.models.candidate_model import CandidateModel
from engine.guiding.policy.costs import IterationCosts
from engine.guiding.policy.guidance import Guidance
from engine.guiding.records.cache_records import CACHE_RECORD_ROWS, allocate_cache_records
from engine.guiding.records.unit_records import UnitRecords
from engine.guiding.records.vertices import RECORD_ROWS, allocate_log, allocate_vertex_records
from engine.guiding.sampling.guide import allocate_guide_of, with_field
from engine.kernels.clock import begin
from engine.render.photon_maps import CHUNK
from engine.ris.candidates import CANDIDATE_ROWS, allocate_candidates
from engine.runtime.bundle import Bundle
from engine.runtime.stage_table import StageTable
from engine.settings import RenderSettings
from engine.state.columns import copy_of, rows_of
from engine.state.film import PLAIN_LAYOUT, FilmLayout, FilmTile, allocate_tile
from engine.state.lanes import (
    LANE_COUNT,
    RGB,
    allocate_cached_lanes,
    allocate_catcher_lanes,
    allocate_closures,
    allocate_feature_lanes,
    allocate_guided_lanes,
    allocate_light_draws,
    allocate_light_pass_lanes,
    allocate_light_samples,
    allocate_paths,
    allocate_points,
    allocate_shadow_rays,
    as_rgb,
    value_width,
)
from engine.state.media import allocate_media_lanes
from engine.state.passed_hits import allocate_passed_hits
from engine.state.photons import PhotonLanes, allocate_photon_lanes, photon_width
from engine.state.shaders import RayOps, ShaderArrays, allocate_memory
from engine.state.tracking import allocate_tracked_lanes
from engine.state.unit import BRIDGE, Unit, UnitCosts
from engine.state.walks import allocate_walk_lanes
from engine.wavefront.columns import (
    CACHE_RECORDS,
    CACHED_DEPTHS,
    CACHED_PATHS,
    CANDIDATES,
    CLOCK,
    CLOSEST_RAYS,
    COUNT_WIDTH,
    GUIDED_VERTICES,
    MAJORANTS_EXCEEDED,
    MEDIA_DROPPED,
    MEDIUM_REJECTS,
    NEXT_PATH,
    RECORD_REJECTS,
    RECORDS,
    RECORDS_DROPPED,
    REJECTS,
    RESAMPLED_CANDIDATES,
    RESAMPLED_VERTICES,
    SCENE_HANDLE,
    SHADOW_RAYS,
    TRACKING_ENDED,
    TRANSPARENT_SHADOW_RAYS,
)
from engine.wavefront.node_rays import NodeRays
from engine.wavefront.work import QUEUES, GuidanceView, RadianceView, SceneView, Work, allocate_queue

#: Photons that a thread keeps of those that it has sent off at a time: eight of each would fit.
PHOTON_ROWS = 8 * CHUNK
#: Paths in flight where there are strands or points: rays look into more memory than a core has near it, and so find
#: there what the last few rays have read.
LANES_AMONG_STRANDS = 128


class Arm(NamedTuple):
    """One way that units of an iteration are rendered.

    guidance : Guidance or None
    learned : dict, fields of `GuidanceView` but for the thread's own
    radiance : RadianceView, without the model
    view : SceneView, with the lights that were chosen when it was made
    header : int64 (UNIT_HEADER_WIDTH,), what its units have in common of `UnitView.header`
    model : CandidateModel or None, what weighs candidates if neither a table nor the mixture does
    """

    guidance: Guidance | None
    learned: dict[str, Any]
    radiance: RadianceView
    view: SceneView
    header: np.ndarray
    model: CandidateModel | None = None


@dataclass
class Statistics:
    """Counts and times of one thread (or, added up, of all)."""

    stage_seconds: Counter[str] = field(default_factory=Counter)
    rays: Counter[str] = field(default_factory=Counter)
    path_count: int = 0
    #: Samples, and records of what was found, that were not finite.
    reject_count: int = 0
    record_reject_count: int = 0
    #: Records that a unit had no room for.
    record_drop_count: int = 0
    #: Entries into more media at once than a path has room for.
    medium_drop_count: int = 0
    #: Points where media that vary were denser than their bound, where they were no numbers, and rays given up in them.
    majorant_excess_count: int = 0
    medium_reject_count: int = 0
    tracking_end_count: int = 0
    #: Vertices that were guided, those of them with several candidates, and all candidates, and theirs.
    guided_count: int = 0
    several_count: int = 0
    candidate_count: int = 0
    several_candidate_count: int = 0
    #: Paths that ended, or could have, in the radiance cache, by how often they had been scattered (the last: or more).
    cached_counts: Counter[int] = field(default_factory=Counter)

    def add(self, other: Statistics) -> None:
        """Add another thread's."""
        self.stage_seconds.update(other.stage_seconds)
        self.rays.update(other.rays)
        self.path_count += other.path_count
        self.reject_count += other.reject_count
        self.record_reject_count += other.record_reject_count
        self.record_drop_count += other.record_drop_count
        self.medium_drop_count += other.medium_drop_count
        self.majorant_excess_count += other.majorant_excess_count
        self.medium_reject_count += other.medium_reject_count
        self.tracking_end_count += other.tracking_end_count
        self.guided_count += other.guided_count
        self.several_count += other.several_count
        self.candidate_count += other.candidate_count
        self.several_candidate_count += other.several_candidate_count
        self.cached_counts.update(other.cached_counts)

    def since(self, before: Statistics) -> IterationCosts:
        """What has been counted since then."""
        return IterationCosts(
            self.stage_seconds - before.stage_seconds,
            sum(self.rays.values()) - sum(before.rays.values()),
            self.path_count - before.path_count,
            self.guided_count - before.guided_count,
            self.several_count - before.several_count,
            self.several_candidate_count - before.several_candidate_count,
            self.record_drop_count - before.record_drop_count,
            self.rays["closest"] - before.rays["closest"],
        )


class _Counted:
    """What units of one thread have counted, in arrays: a counter by name for each would take as long as short units.

    Attributes
    ----------
    ticks : int64, by entry of the clock
    counts : int64 (COUNT_WIDTH,), as `Work.counts`
    seconds : float, that the clock's ticks took together
    path_count : int
    """

    def __init__(self) -> None:
        self.seconds = 0.0
        self.ticks = np.zeros(len(CLOCK), np.int64)
        self.counts = np.zeros(COUNT_WIDTH, np.int64)
        self.path_count = 0

    def statistics(self) -> Statistics:
        """By name."""
        counts, ticks = self.counts.tolist(), self.ticks.tolist()
        per_tick = self.seconds / max(sum(ticks), 1)
        return Statistics(
            stage_seconds=Counter(
                {name: per_tick * of_entry for name, of_entry in zip(CLOCK._fields, ticks, strict=True) if of_entry}
            ),
            rays=Counter(
                closest=counts[CLOSEST_RAYS],
                shadow=counts[SHADOW_RAYS],
                transparent_shadow=counts[TRANSPARENT_SHADOW_RAYS],
            ),
            path_count=self.path_count,
            reject_count=counts[REJECTS],
            record_reject_count=counts[RECORD_REJECTS],
            record_drop_count=counts[RECORDS_DROPPED],
            medium_drop_count=counts[MEDIA_DROPPED],
            majorant_excess_count=counts[MAJORANTS_EXCEEDED],
            medium_reject_count=counts[MEDIUM_REJECTS],
            tracking_end_count=counts[TRACKING_ENDED],
            guided_count=counts[GUIDED_VERTICES],
            several_count=counts[RESAMPLED_VERTICES],
            candidate_count=counts[CANDIDATES],
            several_candidate_count=counts[RESAMPLED_CANDIDATES],
            cached_counts=Counter({depth + 1: counts[CACHED_PATHS + depth] for depth in range(CACHED_DEPTHS)}),
        )


def _photon_lanes(
    lane_count: int, pixel_count: int, piece_count: int, settings: RenderSettings, *, moves: bool, has_media: bool
) -> PhotonLanes:
    """Memory for photons, next to none where there are none; in media they leave several marks each."""
    if not settings.traces_photons:
        return allocate_photon_lanes(1, 1, 1, 1)
    rows = PHOTON_ROWS * (3 if has_media else 1)
    width = photon_width(moves=moves, is_spectral=settings.channel_count > RGB)
    return allocate_photon_lanes(lane_count, rows, pixel_count, piece_count, width)


class Batch:
    """One thread's memory: everything a unit needs, allocated once for many renders.

    Parameters
    ----------
    shaders : ShaderArrays
    pixel_count : int
        Most rows that a unit has on the film.
    settings : RenderSettings
    layout : FilmLayout
        Which sums the film has.
    is_guided : bool
        Whether there is room for what guides paths.
    records : bool
        Whether there is room to record paths.
    piece_count : int
        Pieces of casters, from which photons begin.
    moves : bool
        Whether photons have a time that counts.
    """

    def __init__(
        self, shaders: ShaderArrays, pixel_count: int, settings: RenderSettings, layout: FilmLayout = PLAIN_LAYOUT,
        *, is_guided: bool = False, records: bool = False, piece_count: int = 0, moves: bool = False,
    ) -> None:
        lanes, channel_count = LANE_COUNT, settings.channel_count
        # Both have one type, though only surfaces have AOVs: shaders are compiled once for both.
        closures, light_closures = (
            allocate_closures(lanes, channel_count, layout.data.options.aov_width) for _ in range(2)
        )
        self.is_guided, self.has_records = is_guided, records
        self.uses_cache = uses_cache = settings.radiance_cache != "OFF"
        self.predicts = settings.learns_roulette
        self._scratch = RayScratch()
        has_log = records and (is_guided or self.predicts or settings.learns_lights)
        self.records = allocate_vertex_records(RECORD_ROWS if has_log else 1, channel_count)
        self.work = Work(
            counts=np.zeros(COUNT_WIDTH, np.int64),
            clock=np.zeros(len(CLOCK) + 1, np.int64),
            ray=self._scratch.ray,
            ray_bits=self._scratch.bits,
            ray_address=np.array([self._scratch.address], np.int64),
            registers=allocate_memory(shaders),
            **{name: allocate_queue(lanes) for name in QUEUES},
            f_cos=np.zeros((lanes, value_width(channel_count)), np.float32),
            paths=allocate_paths(lanes, channel_count),
            points=allocate_points(lanes),
            closures=closures,
            shaded=as_rgb(closures),
            samples=allocate_light_samples(lanes, channel_count),
            draws=allocate_light_draws(),
            shadows=allocate_shadow_rays(lanes, channel_count),
            passed=allocate_passed_hits(lanes),
            light_points=allocate_points(lanes),
            light_closures=light_closures,
            light_shaded=as_rgb(light_closures),
            guided=allocate_guided_lanes(lanes),
            features=allocate_feature_lanes(
                lanes if layout.use_denoising else 1, lanes if layout.data.options.asks_for_mirrors else 1
            ),
            cached=allocate_cached_lanes(lanes if uses_cache else 1, channel_count),
            passes=allocate_light_pass_lanes(lanes, channel_count, layout.light_part_count),
            catcher=allocate_catcher_lanes(lanes if layout.has_catchers else 1, channel_count),
            media=allocate_media_lanes(
                lanes if layout.has_media else 0, channel_count, has_shadows=layout.has_varying_media
            ),
            tracking=allocate_tracked_lanes(2 * lanes if layout.has_varying_media else 1, channel_count),
            walks=allocate_walk_lanes(lanes, channel_count),
            photons=_photon_lanes(
                lanes, pixel_count, piece_count, settings, moves=moves, has_media=layout.has_media
            ),
            log=allocate_log(lanes, use_vertices=has_log),
            candidates=allocate_candidates(CANDIDATE_ROWS if is_guided else 1, channel_count),
            records=self.records,
            cache_records=allocate_cache_records(CACHE_RECORD_ROWS if records and uses_cache else 1),
        )
        self._queue_counts = [getattr(self.work, name).count for name in QUEUES]
        #: Whether no unit changes what lanes have where nothing guides them.
        self._stays_plain = not (is_guided or records or layout.has_media)
        self.work.samples.cluster[:] = -1
        self._guide_none()
        self._guide = allocate_guide_of(settings, lanes if is_guided else 1)
        self.film: FilmTile = allocate_tile(pixel_count, RGB, layout)
        self._film_arrays = [array for array in self.film if array.size]
        #: Lanes from the last down to the first.
        self._lanes = np.arange(lanes - 1, -1, -1, dtype=np.int32)
        self.no_weight = np.zeros(pixel_count, np.float32)
        #: Of all arms but BRIDGE, whose units may be traced while the others' counts are read; and of this one.
        self._counted, self._bridge_counted = _Counted(), _Counted()
        #: Of the last unit: time [s], rays, guided vertices, and candidates of vertices with several.
        self.unit_costs = UnitCosts()
        self._arm: Arm | None = None
        self.guidance: GuidanceView | None = None
        self._model: CandidateModel | None = None
        self._model_memory: Bundle | None = None

    def take(self, scene: SceneView, ray_ops: StageTable | None = None) -> None:
        """Be ready for another render, of this scene.

        Parameters
        ----------
        ray_ops : StageTable, optional
            What traces the rays of its materials' nodes, where they have any.
        """
        traced = None if ray_ops is None else RayOps(ray_ops, self._node_rays(scene))
        self.work = self.work._replace(registers=allocate_memory(scene.shaders, traced))
        # Scenes without dense media, and those without emitters, have no stage that sets them.
        self.work.media.gap[:] = 0.0
        self.work.media.is_lit[:] = 0
        self.work.media.collision_share[:] = 1.0
        self._guide = with_field(self._guide, None)
        self._arm = self.guidance = self._model = None
        self._counted, self._bridge_counted, self.unit_costs = _Counted(), _Counted(), UnitCosts()

    def _node_rays(self, scene: SceneView) -> NodeRays:
        """What rays of nodes in materials need."""
        work = self.work
        return NodeRays(
            scene.header[SCENE_HANDLE : SCENE_HANDLE + 1], scene.local_scenes,
            np.array([scene.options.occlusion_distance], np.float32), work.ray, work.ray_bits, work.ray_address,
            work.paths,
        )  # fmt: skip

    def take_records(self) -> UnitRecords:
        """What the unit in work has recorded, in arrays of its own."""
        counts = self.work.counts
        return UnitRecords(
            copy_of(rows_of(self.records, 0, counts[RECORDS])),
            copy_of(rows_of(self.work.cache_records, 0, counts[CACHE_RECORDS])),
        )

    def follow(self, arm: Arm) -> GuidanceView:
        """Draw directions from what an iteration has learned.

        Raises
        ------
        TypeError
            If what was learned is not of the shape that kernels were compiled for.
        """
        # Unguided units read nothing of it, and need no new one.
        if self.guidance is None or (arm.guidance is not None and arm is not self._arm):
            self._arm = arm
            if arm.guidance is not None:
                self._guide = with_field(self._guide, arm.guidance.source)
            guidance = GuidanceView(**arm.learned, guide=self._guide)
            if self.guidance is not None and guidance._numba_type_ != self.guidance._numba_type_:
                raise TypeError("what was learned is not of the shape that kernels were compiled for")
            self.guidance = guidance
        return self.guidance

    def predict_by(self, arm: Arm) -> RadianceView:
        """What predicts radiance, and where paths end, with this thread's memory of the arm's model."""
        if arm.model is None:
            return arm.radiance
        if arm.model is not self._model or self._model_memory is None:
            self._model, self._model_memory = arm.model, arm.model.memory(self._model_memory)
        return arm.radiance._replace(model=self._model_memory)

    def begin(self, lane_count: int = LANE_COUNT) -> None:
        """So many lanes free, nothing counted, the film black."""
        work = self.work
        for array in self._film_arrays:
            array.fill(0)
        for count in self._queue_counts:
            count[0] = 0
        work.free.lanes[:lane_count] = self._lanes[len(self._lanes) - lane_count :]
        work.free.count[0] = lane_count
        work.counts[:] = 0
        work.clock[:] = 0
        work.closures.aovs[:] = 0.0
        if not self._stays_plain:
            # Stays where nobody learns which lights to sample.
            work.samples.cluster[:] = -1
            self._guide_none()
        begin(work.clock)

    def begin_followers(self) -> None:
        """As `begin`, for the followers of a unit that has been traced: what that has left stays."""
        self.work.counts[NEXT_PATH] = 0
        if not self._stays_plain:
            self._guide_none()

    def _guide_none(self) -> None:
        work = self.work
        # No lane is guided, whatever the last unit was.
        work.guided.rough_share[:] = 0.0
        work.samples.guide_pdf[:] = 0.0
        work.samples.bsdf_share[:] = work.samples.weight[:] = 1.0

    @property
    def statistics(self) -> Statistics:
        """What units of all arms but BRIDGE have counted."""
        return self._counted.statistics()

    @property
    def bridge_statistics(self) -> Statistics:
        """What units of the arm BRIDGE have counted."""
        return self._bridge_counted.statistics()

    def count(self, unit: Unit, seconds: float, cost: float, *, is_finished: bool) -> None:
        """Add what a unit counted to the statistics; it took so many seconds, of which `cost` is compared."""
        counted = self._bridge_counted if unit.arm == BRIDGE else self._counted
        work = self.work
        counts = work.counts.tolist()
        self.unit_costs = UnitCosts(
            cost, counts[CLOSEST_RAYS] + counts[SHADOW_RAYS], counts[GUIDED_VERTICES], counts[RESAMPLED_CANDIDATES]
        )
        counted.seconds += seconds
        counted.ticks += work.clock[:-1]
        counted.counts += work.counts
        if is_finished:
            counted.path_count += unit.path_count
