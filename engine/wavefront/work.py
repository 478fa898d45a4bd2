# SPDX-License-Identifier: GPL-3.0-or-later
"""What the loop over the stages works on, as bundles: scene, what has been learned, a unit, a thread's memory."""

from __future__ import annotations

import numpy as np

from engine.guiding.fields.cells.field import CellField
from engine.guiding.fields.roulette.field import RouletteField
from engine.guiding.fields.table import TableField
from engine.guiding.fields.vmm.field import VmmField
from engine.guiding.records.cache_records import CacheRecords
from engine.guiding.records.vertices import VertexLog, VertexRecords
from engine.kernels.bsdf.tables import BsdfTables
from engine.ris.candidates import Candidates
from engine.ris.orca import Allocation
from engine.runtime.bundle import Bundle
from engine.spectral.tables import SpectralTables
from engine.state.bake import BakeArrays
from engine.state.data_passes import DataView
from engine.state.film import FilmTile
from engine.state.geometry import GeometryArrays
from engine.state.lanes import (
    CachedLanes,
    CatcherLanes,
    Closures,
    FeatureLanes,
    GuidedLanes,
    LightDraws,
    LightPassLanes,
    LightSamples,
    PathState,
    ShadePoints,
    ShadowRays,
)
from engine.state.lights import LightArrays
from engine.state.media import MediaArrays, MediaLanes
from engine.state.passed_hits import PassedHits
from engine.state.photons import CasterArrays, PhotonLanes, PhotonMap
from engine.state.shaders import ShaderArrays, ShaderMemory
from engine.state.tracking import TrackedLanes
from engine.state.walks import WalkLanes
from engine.wavefront.options import GuidingOptions, IntegratorOptions


class SceneView(Bundle):
    """A scene with the settings that no iteration changes, for kernels.

    header : int64 (SCENE_HEADER_WIDTH,)
    local_scenes : int64, `engine.accel.local_rays.build_local_scenes`
    camera, camera_motion, shutter, pixel_filter : float32, as `engine.builder.camera.CameraArrays`
    """

    header: np.ndarray
    camera: np.ndarray
    camera_motion: np.ndarray
    shutter: np.ndarray
    pixel_filter: np.ndarray
    spectrum: SpectralTables
    geometry: GeometryArrays
    shaders: ShaderArrays
    tables: BsdfTables
    lights: LightArrays
    media: MediaArrays
    data: DataView
    bake: BakeArrays
    casters: CasterArrays
    photons: PhotonMap
    local_scenes: np.ndarray
    options: IntegratorOptions


class NoModel(Bundle):
    """In the place of a model's memory where there is none; nobody reads it.

    nothing : uint8 (1,)
    """

    nothing: np.ndarray


class RadianceView(Bundle):
    """What predicts radiance along candidates, if it is not the mixture, and where paths end; where there is none, its
    shape and never read, or cells that know nothing; and what roulette goes by.

    model : `engine.guiding.models.candidate_model.CandidateModel.memory`, of any class: only the stage that asks it is
        compiled for that
    """

    _opaque = frozenset({"model"})

    table: TableField
    model: Bundle
    cells: CellField
    roulette_field: RouletteField


class GuidanceView(Bundle):
    """`engine.guiding.policy.guidance.Guidance` for kernels; where there is none, of its shape and never read.

    probability : float32 (R,) or (2 R,), of guiding on surfaces and within media
    light_share : float32 (R,), of sampling a light
    benefit : float32 (R,), of guiding (`engine.guiding.models.selection.SelectionModel`)
    guide : a thread's lanes, see `engine.guiding.sampling.guide`
    """

    options: GuidingOptions
    field: VmmField
    allocation: Allocation
    probability: np.ndarray
    light_share: np.ndarray
    benefit: np.ndarray
    guide: Bundle


class UnitView(Bundle):
    """A tile of pixels by a range of samples.

    header : int64 (UNIT_HEADER_WIDTH,)
    pixels : int32 (P, 2), column and row in the full image
    pixel_weight : float32 (P,), of ALL_STRATA (P * strata,), a pixel's strata one after the other
        (`engine.ris.orca.pixel_weights`)
    film : sums, as many rows as `pixel_weight` or more
    """

    header: np.ndarray
    pixels: np.ndarray
    pixel_weight: np.ndarray
    film: FilmTile


class LaneQueue(Bundle):
    """Lanes that wait for a stage, or rows of shadow rays.

    lanes : int32 (L,); count : int64 (1,), how many of them wait
    """

    lanes: np.ndarray
    count: np.ndarray


def allocate_queue(lane_count: int) -> LaneQueue:
    """A queue that is empty and has room for all lanes."""
    return LaneQueue(np.zeros(lane_count, np.int32), np.zeros(1, np.int64))


#: Queues in `Work`.
QUEUES = (
    "active", "free", "traced", "tracked", "collided", "surface", "missed", "lit", "programs", "pending", "single",
    "several", "walking",
)  # fmt: skip


class Work(Bundle):
    """A thread's memory, L lanes; of the same type whatever a render is guided by.

    counts : int64 (COUNT_WIDTH,); clock : int64, ticks by `ClockEntries`
    ray, ray_bits : one RTCRayHit, as float32 and as uint32; ray_address : int64 (1,)
    registers : ShaderMemory, of the shader interpreter
    active, free : lanes with a path and without
    traced, tracked, collided, surface, missed, lit, programs, pending : lanes that a stage has left for another
    single, several : guided lanes with one candidate, and with several
    walking : lanes whose path goes in below a surface
    draws : scratch of `choose_lights`
    passed : hits that shadow rays have ahead of them on what may let light through
    light_points, light_closures : of lights and of what shadow rays meet
    shaded, light_shaded : the same closures as shaders see them, in RGB (`engine.state.lanes.as_rgb`)
    passes : light taken apart, for passes of it; catcher : of shadow catchers; media : what paths are in
    walks : what these need
    photons : what lanes know of photons, and those that have arrived
    tracking : how far their rays have been followed through media that vary
    f_cos : float32 (L, `engine.state.lanes.value_width`), scratch for a stage's BSDF value or contribution
    """

    counts: np.ndarray
    clock: np.ndarray
    ray: np.ndarray
    ray_bits: np.ndarray
    ray_address: np.ndarray
    registers: ShaderMemory
    active: LaneQueue
    free: LaneQueue
    traced: LaneQueue
    tracked: LaneQueue
    collided: LaneQueue
    surface: LaneQueue
    missed: LaneQueue
    lit: LaneQueue
    programs: LaneQueue
    pending: LaneQueue
    single: LaneQueue
    several: LaneQueue
    walking: LaneQueue
    f_cos: np.ndarray
    paths: PathState
    points: ShadePoints
    closures: Closures
    shaded: Closures
    samples: LightSamples
    draws: LightDraws
    shadows: ShadowRays
    passed: PassedHits
    light_points: ShadePoints
    light_closures: Closures
    light_shaded: Closures
    guided: GuidedLanes
    cached: CachedLanes
    features: FeatureLanes
    passes: LightPassLanes
    catcher: CatcherLanes
    media: MediaLanes
    tracking: TrackedLanes
    walks: WalkLanes
    photons: PhotonLanes
    log: VertexLog
    candidates: Candidates
    records: VertexRecords
    cache_records: CacheRecords
