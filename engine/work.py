# SPDX-License-Identifier: GPL-3.0-or-later
"""What the loop over the stages works on, as bundles: scene, what has been learned, a unit, a thread's memory."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from engine.bundle import Bundle
from engine.film import FilmTile
from engine.guiding.network_query import NetworkField
from engine.guiding.table import TableField
from engine.guiding.vertices import VertexLog, VertexRecords
from engine.guiding.vmm.field import VmmField
from engine.kernels.bsdf.tables import BsdfTables
from engine.ris.candidates import Candidates
from engine.ris.orca import Allocation
from engine.scene.arrays import GeometryArrays
from engine.scene.light_arrays import LightArrays
from engine.shaders.arrays import ShaderArrays
from engine.spectral.tables import SpectralTables
from engine.state import Closures, GuidedLanes, LightSamples, PathState, ShadePoints, ShadowRays

# SceneView.header
SCENE_HANDLE = 0  # Embree's, an address
SCENE_WIDTH = 1  # of the full image [px]
SCENE_WORLD_PROGRAM = 2
SCENE_WORLD_VISIBILITY = 3
SCENE_WORLD_IS_CONSTANT = 4
SCENE_HAS_EMITTERS = 5
SCENE_HAS_HITTABLE_LIGHTS = 6
SCENE_HAS_TRANSPARENT_SHADOWS = 7
SCENE_IS_SPECTRAL = 8  # paths have wavelengths
SCENE_HEADER_WIDTH = 9


class SceneView(Bundle):
    """A scene with the settings that no iteration changes.

    header : int64 (SCENE_HEADER_WIDTH,)
    camera, camera_motion, shutter, pixel_filter : float32, as `engine.scene.camera.CameraArrays`
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


class GuidanceView(Bundle):
    """`engine.guidance.Guidance` for kernels; where there is none, of its shape and never read.

    probability : float32 (R,), of guiding; light_share : float32 (R,), of sampling a light
    benefit : float32 (R,), of guiding
    """

    field: VmmField
    table: TableField
    network: NetworkField
    allocation: Allocation
    probability: np.ndarray
    light_share: np.ndarray
    benefit: np.ndarray


#: Unit.stratum: samples lie in all of the shutter, and have a row of the film for each stratum.
ALL_STRATA = -1

# Unit.arm
PLAIN = -1
CURRENT = 0
CHALLENGER = 1


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
    #: Which of the methods in use renders it: PLAIN, or by what has been learned, with paths recorded to learn more.
    arm: int = 0
    #: Part of u that its samples lie in, of so many equal ones (`engine.strata`).
    stratum: int = 0
    strata: int = 1


@dataclass(frozen=True)
class UnitCosts:
    """What a unit took: by the clock [s], and counted."""

    seconds: float = 0.0
    ray_count: int = 0
    guided_vertices: int = 0
    resampled_candidates: int = 0


# UnitView.header
UNIT_SEED = 0
UNIT_SAMPLE_FIRST = 1
UNIT_PATH_COUNT = 2
UNIT_RECORD_THRESHOLD = 3
UNIT_IS_GUIDED = 4
UNIT_SHADER_MODE = 5
UNIT_USE_FEATURES = 6
UNIT_STRATUM = 7
UNIT_STRATA = 8
UNIT_DIVIDES_WAVELENGTHS = 9
UNIT_HEADER_WIDTH = 10


class UnitView(Bundle):
    """A tile of pixels by a range of samples.

    header : int64 (UNIT_HEADER_WIDTH,)
    pixels : int32 (P, 2), column and row
    pixel_weight : float32 (P,), of ALL_STRATA (P * strata,), a pixel's strata one after the other
    film : sums, as many rows as `pixel_weight` or more
    """

    header: np.ndarray
    pixels: np.ndarray
    pixel_weight: np.ndarray
    film: FilmTile


# Work.counts: where a unit stands, then, from REJECTS on, what has been counted in it.
NEXT_PATH = 0
ACTIVE = 1
FREE = 2
RECORDS = 3
REJECTS = 4
CLOSEST_RAYS = 5
SHADOW_RAYS = 6
TRANSPARENT_SHADOW_RAYS = 7
GUIDED_VERTICES = 8
RESAMPLED_VERTICES = 9
CANDIDATES = 10
RESAMPLED_CANDIDATES = 11
COUNT_WIDTH = 12

#: Entries of `Work.clock`, whose last element is the last mark.
CLOCK_ENTRIES = (
    "init_from_camera",
    "play_roulette",
    "intersect_closest",
    "shade_lights",
    "prepare_surface",
    "shade_background",
    "evaluate_shaders",
    "upsample",
    "shade_emission",
    "write_features",
    "prepare_guides",
    "write_guiding",
    "choose_lights",
    "evaluate_light_shaders",
    "guide_lights",
    "connect_lights",
    "intersect_shadow",
    "scatter",
    "sample_source",
    "draw_candidates",
    "predict_radiance",
    "guide_resample",
    "collect_records",
    "accumulate",
)


#: Lists of lanes in `Work`.
LANE_LISTS = (
    "active", "free", "traced", "surface", "missed", "lit", "programs", "pending", "single", "several",
)  # fmt: skip


class Work(Bundle):
    """A thread's memory, L lanes.

    counts : int64 (COUNT_WIDTH,); clock : int64, ticks by CLOCK_ENTRIES
    ray, ray_bits : one RTCRayHit, as float32 and as uint32; ray_address : int64 (1,)
    registers : float32, of the shader interpreter
    active, free : int32 (L,), lanes with a path and without
    traced, surface, missed, lit, programs, pending : int32 (L,), lanes that a stage has left for another
    single, several : int32 (L,), guided lanes with one candidate, and with several
    light_points, light_closures : of lights and of what shadow rays meet
    shaded, light_shaded : the same closures as shaders see them, in RGB (`engine.state.as_rgb`)
    f_cos : float32 (L, `engine.state.value_width`)
    guide : see `engine.guiding.guide`
    latent, hidden : float32, activations of a network (`engine.guiding.network_query.predict_network`)
    """

    counts: np.ndarray
    clock: np.ndarray
    ray: np.ndarray
    ray_bits: np.ndarray
    ray_address: np.ndarray
    registers: np.ndarray
    active: np.ndarray
    free: np.ndarray
    traced: np.ndarray
    surface: np.ndarray
    missed: np.ndarray
    lit: np.ndarray
    programs: np.ndarray
    pending: np.ndarray
    single: np.ndarray
    several: np.ndarray
    f_cos: np.ndarray
    latent: np.ndarray
    hidden: np.ndarray
    paths: PathState
    points: ShadePoints
    closures: Closures
    shaded: Closures
    samples: LightSamples
    shadows: ShadowRays
    light_points: ShadePoints
    light_closures: Closures
    light_shaded: Closures
    guided: GuidedLanes
    log: VertexLog
    guide: Bundle
    candidates: Candidates
    records: VertexRecords
