# SPDX-License-Identifier: GPL-3.0-or-later
"""The one schema of per-path data: batches of lanes, one per thread, allocated once.

In memory a lane's fields lie side by side in whole cache lines (`_records`), those that stages use together in the same
line: lanes in flight are visited in any order, and a stage should fetch few lines for each. In code every field is an
array of its own all the same, indexed by lane.

`channels` is a tuple whose *length* is the spectrum's width (3 for RGB, 4 for hero wavelengths). Numba types a tuple by
its length, so `for c in range(len(paths.channels))` unrolls and both widths live in one process. What only wavelengths
need stands behind `if len(paths.channels) > RGB:`, which costs an RGB render nothing; its fields have no lanes there.
"""

from __future__ import annotations

import numpy as np

from engine.array_types import Float32Array, Int16Array, Int32Array, Int64Array, Uint8Array, Uint32Array
from engine.runtime.bundle import Bundle
from engine.spectral.wavelengths import WAVELENGTH_COUNT as WAVELENGTHS

_CACHE_LINE = 64

#: Channels of a render without wavelengths.
RGB = 3


def aligned_bytes(byte_count: int) -> np.ndarray:
    """Zeroed uint8 array that begins at a cache line."""
    memory = np.zeros(byte_count + _CACHE_LINE, np.uint8)
    start = -memory.ctypes.data % _CACHE_LINE
    return memory[start : start + byte_count]


def _records(lane_count: int, layout: list[list[tuple]]) -> dict[str, np.ndarray]:
    """Fields of one record a lane, as views.

    Parameters
    ----------
    layout : list of lists of (name, dtype[, shape])
        In the order of memory; each list begins at a cache line.
    """
    names: list[str] = []
    formats: list[object] = []
    offsets: list[int] = []
    size = 0
    for fields in layout:
        for name, dtype, *shape in fields:
            kind = np.dtype((dtype, *shape)) if shape else np.dtype(dtype)
            names.append(name)
            formats.append(kind)
            offsets.append(size)
            size += kind.itemsize
        size += -size % _CACHE_LINE
    record = np.dtype({"names": names, "formats": formats, "offsets": offsets, "itemsize": size})
    memory = aligned_bytes(lane_count * record.itemsize).view(record)
    return {name: memory[name] for name in names}


# ---------------------------------------------------------------------------------------------------------------------
# Path flags (bits of PathState.flags). The first five are the visibility bits of scene.description.

RAY_CAMERA = 1
RAY_DIFFUSE = 2
RAY_GLOSSY = 4
RAY_TRANSMIT = 8
RAY_VOLUME = 16
RAY_SHADOW = 32
RAY_VISIBILITY = 63
RAY_REFLECT = 64
RAY_SINGULAR = 128
#: Passed through a transparent surface since the last scattering.
RAY_TRANSPARENT = 256
#: The last scattering was a delta lobe or the camera: emission it finds is counted whole, no MIS.
RAY_MIS_SKIP = 512
#: The surface scattered from had a transmissive lobe (the light tree's importance differs there).
RAY_MIS_HAD_TRANSMISSION = 1024
RAY_DIFFUSE_ANCESTOR = 2048
#: The surface scattered from finds all of the background by scattering: light sampling left the dim parts to it.
RAY_MIS_FINDS_ALL = 262144
#: A limit was reached: the next surface only emits, unless it is transparent.
RAY_TERMINATE_AFTER_TRANSPARENT = 4096
RAY_TERMINATE_ON_NEXT_SURFACE = 8192
RAY_ENDS = RAY_TERMINATE_AFTER_TRANSPARENT | RAY_TERMINATE_ON_NEXT_SURFACE
#: Only transparent surfaces since the camera: what is behind counts into alpha.
RAY_TRANSPARENT_BACKGROUND = 16384
#: Set by the shader's evaluation only: emission wanted, nothing else.
RAY_EMISSION = 32768
#: Passes of the first surface have been written.
RAY_PASSES_DONE = 65536
#: The camera's ray has met a shadow catcher.
RAY_CATCHER_HIT = 131072
#: The ray starts on the triangle that its path has hit, in place, and skips it.
RAY_STARTS_ON = 524288
#: The lane's shadow ray starts and ends in place, and skips the triangles there.
RAY_SHADOW_IN_PLACE = 1048576

# ---------------------------------------------------------------------------------------------------------------------
# Columns of ShadePoints.real (float32). Cycles' convention: on a back face both normals are flipped to face the viewer
# and POINT_FLAG_BACKFACING is set.

POINT_P = 0  # world position [m]
POINT_WO = 3  # unit, towards the viewer
POINT_NG = 6  # geometric normal
POINT_NS = 9  # shading normal
POINT_U = 12  # barycentrics as Embree: P = (1 - u - v) v0 + u v1 + v v2
POINT_V = 13
POINT_RAY_LENGTH = 14
POINT_RADIUS = 15  # footprint radius of the ray at P [m] (compact ray differential)
POINT_RANDOM = 16  # uniform in [0, 1), for stochastic nodes
POINT_TIME = 17
POINT_REAL_WIDTH = 18

# Columns of ShadePoints.integer (int32).
POINT_INSTANCE = 0  # -1: none (background or analytic light)
POINT_TRIANGLE = 1  # row of GeometryArrays.triangles
POINT_PROGRAM = 2  # row of ShaderArrays.programs
POINT_RAY_FLAGS = 3
POINT_FLAGS = 4
# Surfaces that the path has met, by kind (`kernels/path_depths.py`).
POINT_PATH_DEPTH = 5
POINT_DIFFUSE_DEPTH = 6
POINT_GLOSSY_DEPTH = 7
POINT_TRANSMISSION_DEPTH = 8
POINT_TRANSPARENT_DEPTH = 9
POINT_LIGHT = 10  # analytic light being evaluated, -1 = none
POINT_INTEGER_WIDTH = 11

POINT_FLAG_BACKFACING = 1
#: Of an instance that is far from the origin: see INSTANCE_FLAG_FAR.
POINT_FLAG_FAR = 2


class ShadePoints(Bundle):
    """Points at which shader programs run: surface hits, light samples, background directions, shadow hits.

    real : float32 (L, POINT_REAL_WIDTH)
    integer : int32 (L, POINT_INTEGER_WIDTH)
    """

    _rows = True
    real: Float32Array
    integer: Int32Array


# ---------------------------------------------------------------------------------------------------------------------
# Closures: the result of a shader program at a point.

MAX_CLOSURES = 16
CLOSURE_WIDTH = 32
CLOSURE_CHANNELS = 4

# Columns of Closures.param common to all kinds; the rest belongs to the kind (engine/kernels/bsdf). The first sixteen
# are one cache line: what simple lobes need should stay there.
CLOSURE_WEIGHT = 0  # 4 channels
CLOSURE_N = 4  # unit normal, on the viewer's side
CLOSURE_SAMPLE_WEIGHT = 7  # unnormalised selection probability
_CLOSURE_KIND = 8  # Closures.kind
CLOSURE_KIND_PARAMS = 9
#: Paths in flight per thread, and the most lanes any batch may have: the distance between a lane's closures is part of
#: their type, so that another would compile the kernels again. Their state has to stay near the core; fewer make the
#: calls between stages show.
LANE_COUNT = 2048
#: Lanes between a lane's closures in memory (all first closures lie together, then all second ones); not a power of
#: two, or they would compete for the same places in the cache.
_CLOSURE_LANES = LANE_COUNT + 8


class Closures(Bundle):
    """Weighted lobes per lane.

    kind : int32 (L, MAX_CLOSURES), engine.kernels.bsdf.kinds
    param : float32 (L, MAX_CLOSURES, CLOSURE_WIDTH)
    count : int32 (L,)
    emission : float32 (L, 4), radiance emitted towards wo, per channel
    transparency : float32 (L, 4), summed weight of transparent closures
    holdout : float32 (L,), weight of holdout closures
    ns : float32 (L, 3), smooth shading normal, before bump and normal maps (`bsdf.reset_closures` sets it)
    flags : int32 (L,), CLOSURE_* bits of engine.kernels.bsdf.kinds
    dispersion : float32 (L,) [um^2], of the material (`engine.spectral.dispersion`); wavelength [nm], share : float32
        (L, WAVELENGTHS), of the path, see `PathState`. Set where the lane disperses (CLOSURE_DISPERSES), else not read
    aovs : float32 (L A,), what programs leave for AOVs, A columns a lane (`DataOptions.aov_width`); camera rays only
    channels : tuple of ints, its length is the spectrum's width
    """

    _rows = True
    kind: Int32Array
    param: Float32Array
    count: Int32Array
    emission: Float32Array
    transparency: Float32Array
    holdout: Float32Array
    ns: Float32Array
    flags: Int32Array
    dispersion: Float32Array
    wavelength: Float32Array
    share: Float32Array
    aovs: Float32Array
    channels: tuple[int, ...]


def _without_wavelengths(scalar: str) -> dict[str, np.ndarray]:
    """Fields that a render in RGB has no use for: `wavelength`, `share` and one number a lane."""
    return {
        scalar: np.zeros(0, np.float32),
        "wavelength": np.zeros((0, WAVELENGTHS), np.float32),
        "share": np.zeros((0, WAVELENGTHS), np.float32),
    }


def value_width(channel_count: int) -> int:
    """Columns that a BSDF's value takes: its channels; with wavelengths three times as many.

    The second third is the density by channel of lanes that disperse, the last is for work.
    """
    return channel_count if channel_count == RGB else 3 * channel_count


def allocate_points(lane_count: int) -> ShadePoints:
    """Zeroed `ShadePoints` for `lane_count` lanes."""
    width = POINT_REAL_WIDTH + POINT_INTEGER_WIDTH
    memory = aligned_bytes(lane_count * 2 * _CACHE_LINE).view(np.float32).reshape(lane_count, -1)
    return ShadePoints(memory[:, :POINT_REAL_WIDTH], memory.view(np.int32)[:, POINT_REAL_WIDTH:width])


def allocate_closures(lane_count: int, channel_count: int = 3, aov_width: int = 0) -> Closures:
    """Zeroed `Closures` for `lane_count` lanes, at most `LANE_COUNT`, of a spectrum of `channel_count`.

    `aov_width` is the columns of all AOVs; closures without any must not meet camera rays and programs that have some.
    """
    if lane_count > LANE_COUNT:
        raise ValueError(f"closures for {lane_count} lanes: a batch has at most {LANE_COUNT}")
    real, integer = np.float32, np.int32
    memory = aligned_bytes(MAX_CLOSURES * _CLOSURE_LANES * CLOSURE_WIDTH * 4).view(real)
    param = memory.reshape(MAX_CLOSURES, _CLOSURE_LANES, CLOSURE_WIDTH)[:, :lane_count].transpose(1, 0, 2)
    fields = _records(
        lane_count,
        [
            [
                ("count", integer),
                ("flags", integer),
                ("holdout", real),
                ("ns", real, 3),
                ("emission", real, CLOSURE_CHANNELS),
                ("transparency", real, CLOSURE_CHANNELS),
            ]
        ],
    )
    if channel_count == RGB:
        fields |= _without_wavelengths("dispersion")
    else:
        # Apart, so that shaders meet the same closures (`as_rgb`) and are not compiled again.
        fields |= _records(
            lane_count, [[("wavelength", real, WAVELENGTHS), ("share", real, WAVELENGTHS), ("dispersion", real)]]
        )
    return Closures(
        kind=param.view(integer)[:, :, _CLOSURE_KIND], param=param, **fields,
        # One element at least: that of an empty array has another stride, and so all kernels would be others.
        aovs=np.zeros(max(lane_count * aov_width, 1), np.float32), channels=tuple(range(channel_count)),
    )


def as_rgb(closures: Closures) -> Closures:
    """The same closures as shaders see them: their colours are RGB, whatever the render's spectrum."""
    if len(closures.channels) == RGB:
        return closures
    return closures._replace(**_without_wavelengths("dispersion"), channels=tuple(range(RGB)))


# ---------------------------------------------------------------------------------------------------------------------
# Paths


class PathState(Bundle):
    """A batch of paths in flight, L lanes.

    pixel : int32, index into the film; sample : int32
    rng : uint32, hash of (seed, pixel); dimension : int32, next unused set of random numbers
    origin, direction : float32 (L, 3), world; time : float32
    throughput, radiance : float32 (L, C); radiance is what the path has gathered so far
    unguided : float32, factor that makes of the throughput what it would be by plain sampling, where nothing has been
        learned: directions by the BSDF, roulette by the throughput. Roulette and clamping go by it
    mis_pdf : float32 [sr^-1], density of the last scattering (source density), for MIS at the next emitter; 0 of the
        camera's rays, which nothing is weighed against
    unguided_pdf : float32 [sr^-1], the same by plain sampling; -1 where light sampling was of whole segments within
        media, whose samples know nothing of this scattering
    mis_origin, mis_normal : float32 (L, 3), where the light tree stood at the last scattering
    mis_distance : float32, length of the ray since the last scattering, through transparent surfaces
    reach : float32 [m], how far the ray goes from `mis_origin`: as far as the camera sees, or without an end
    min_pdf : float32, smallest scattering density so far (filter_glossy)
    radius, spread : float32, compact ray differential: footprint [m] at the origin, growth per metre
    alpha : float32, 1 - transparency seen by the camera so far
    flags : int32 (RAY_*); depth counters : int16
    hit_* : the closest hit: distance (before the search: how far to look), barycentrics, instance (-1 = miss),
        triangle (row of GeometryArrays.triangles)
    offset : float32 [m], how far the next ray starts off the surface, to clear the rounding error of P
    random : float32 (L, 4), this vertex's numbers for the BSDF; the last for roulette, then made uniform again
    survival : float32, probability with which roulette lets the path go on behind the next surface; before roulette is
        played the least that guiding asks for, -1 = nothing
    unguided_survival : float32, the same by plain sampling
    alive : uint8, 0 once the path has ended in this round
    hero : float32 in [0, 1), by which wavelengths are drawn; wavelength : float32 (L, WAVELENGTHS) [nm], hero first
    share : float32 (L, WAVELENGTHS), of each wavelength in the path's density: with which it would have been sampled,
        had that been the hero, over the sum of all
    """

    _rows = True
    pixel: Int32Array
    sample: Int32Array
    rng: Uint32Array
    dimension: Int32Array
    origin: Float32Array
    direction: Float32Array
    time: Float32Array
    throughput: Float32Array
    radiance: Float32Array
    unguided: Float32Array
    mis_pdf: Float32Array
    unguided_pdf: Float32Array
    mis_origin: Float32Array
    mis_normal: Float32Array
    mis_distance: Float32Array
    reach: Float32Array
    min_pdf: Float32Array
    radius: Float32Array
    spread: Float32Array
    alpha: Float32Array
    flags: Int32Array
    depth: Int16Array
    diffuse_depth: Int16Array
    glossy_depth: Int16Array
    transmission_depth: Int16Array
    transparent_depth: Int16Array
    hit_distance: Float32Array
    hit_u: Float32Array
    hit_v: Float32Array
    hit_instance: Int32Array
    hit_triangle: Int32Array
    offset: Float32Array
    random: Float32Array
    survival: Float32Array
    unguided_survival: Float32Array
    alive: Uint8Array
    hero: Float32Array
    wavelength: Float32Array
    share: Float32Array
    channels: tuple[int, ...]


class ShadowRays(Bundle):
    """Light samples waiting for their visibility, at most one a lane.

    Row k waits for path `lane[k]`; how many rows are in use is kept by the integrator.

    lane : int32
    origin, direction : float32 (L, 3); distance : float32
    radiance : float32 (L, C), contribution if unoccluded, throughput and MIS weight included
    weight : float32, what the sample counts for, since others are left out; clamping acts on `radiance` alone
    own, other, share : float32, what clamping goes by (`engine.kernels.clamping.Unguided`)
    transparent_depth : int16, transparent surfaces passed, the path's own included; transparent_left : int16, hits on
        what may be transparent that lie ahead
    """

    _rows = True
    lane: Int32Array
    origin: Float32Array
    direction: Float32Array
    distance: Float32Array
    radiance: Float32Array
    weight: Float32Array
    own: Float32Array
    other: Float32Array
    share: Float32Array
    transparent_depth: Int16Array
    transparent_left: Int16Array
    channels: tuple[int, ...]


class GuidedLanes(Bundle):
    """What is decided for a lane before its light sample is weighed.

    rough_share : float32, probability of scattering off a lobe that is not delta, and resampling it; 0 = not guided,
        the BSDF samples all lobes
    region : int32, of the guiding field; leaf : int32, region that the point itself lies in
    candidate_count : int32
    probability : float32, that the guide proposes a candidate, not the BSDF
    """

    rough_share: Float32Array
    region: Int32Array
    leaf: Int32Array
    candidate_count: Int32Array
    probability: Float32Array


def allocate_guided_lanes(lane_count: int) -> GuidedLanes:
    """`GuidedLanes` of which none is guided."""
    return GuidedLanes(
        np.zeros(lane_count, np.float32), np.zeros(lane_count, np.int32), np.zeros(lane_count, np.int32),
        np.zeros(lane_count, np.int32), np.zeros(lane_count, np.float32),
    )


#: Surfaces at which a recorded path can teach the radiance cache.
MAX_TAUGHT = 12
# Columns of CachedLanes.taught.
TAUGHT_P = 0
TAUGHT_NG = 3
TAUGHT_BEFORE = 6  # throughput on arrival
TAUGHT_RADIANCE = 9  # the path's sum then
TAUGHT_SIDE = 12  # of its footprint
TAUGHT_WIDTH = 13


class CachedLanes(Bundle):
    """What a path knows of the radiance cache, L lanes.

    depth : int32, of the path when it was last looked at
    origin : float32 (L, 3), the vertex before, or the camera; pdf : float32 [sr^-1], with which it sent the path on, 0:
        by a delta lobe or the camera
    seen : float32 [m^2], footprint of the camera's ray at the first surface; root : float32 [m], square root of the
        path's own footprint at the vertex before; arriving : float32 [m], and at the surface that it has hit
    level : uint8, place : int64, tag : uint32, of the cell that is asked first
    is_measured : uint8, whether the path went on where it could have ended
    is_recorded : uint8, whether the path teaches the cache; has_met : uint8, whether it has met a surface that could be
        taught; may_teach : uint8, whether the one that it has hit can be
    taught_count : int32, surfaces so far; taught : float32 (L * MAX_TAUGHT, TAUGHT_WIDTH), row lane * MAX_TAUGHT + k;
        taught_program : int32 (L * MAX_TAUGHT,)
    base : float32 (L, C), radiance gathered until there; predicted : float32 (L, C), what it would have ended with
    """

    _rows = True
    depth: Int32Array
    origin: Float32Array
    pdf: Float32Array
    seen: Float32Array
    root: Float32Array
    arriving: Float32Array
    level: Uint8Array
    place: Int64Array
    tag: Uint32Array
    is_measured: Uint8Array
    is_recorded: Uint8Array
    has_met: Uint8Array
    may_teach: Uint8Array
    taught_count: Int32Array
    base: Float32Array
    predicted: Float32Array
    taught: Float32Array
    taught_program: Int32Array


def allocate_cached_lanes(lane_count: int, channel_count: int = 3) -> CachedLanes:
    """Zeroed `CachedLanes` for `lane_count` lanes."""
    real = np.float32
    fields = _records(
        lane_count,
        [
            [
                ("depth", np.int32),
                ("origin", real, 3),
                ("pdf", real),
                ("seen", real),
                ("root", real),
                ("arriving", real),
                ("place", np.int64),
                ("tag", np.uint32),
                ("level", np.uint8),
                ("is_measured", np.uint8),
                ("is_recorded", np.uint8),
                ("has_met", np.uint8),
                ("may_teach", np.uint8),
                ("taught_count", np.int32),
                ("base", real, channel_count),
                ("predicted", real, channel_count),
            ]
        ],
    )
    rows = lane_count * MAX_TAUGHT
    return CachedLanes(
        **fields, taught=np.zeros((rows, TAUGHT_WIDTH), real), taught_program=np.zeros(rows, np.int32)
    )


# Parts that a path's light is taken apart into, by what it came by at the first surface (`LightPassLanes.parts`).
PART_DIFFUSE = 0  # direct, then indirect light, and so on
PART_GLOSSY = 2
PART_TRANSMISSION = 4
#: The parts of light groups follow; in scenes with media direct and indirect light by these come last.
PART_GROUPS = 6
VOLUME_PARTS = 2


class LightPassLanes(Bundle):
    """Light taken apart, L lanes; without light passes there are no parts.

    share : float32 (L, 2 C), of diffuse lobes, then of glossy ones, in what the path carries since the first surface
        that has scattered it, or in that surface's light sample; transmission has the rest
    parts : float32 (L, C * (PART_GROUPS + groups)), sums of the path's radiance by part, channels side by side
    group : int32 (L,), light group of the lane's light sample, -1 = none
    is_volume : uint8 (L,), whether a medium was the first that has scattered the path, and has all of its light
    is_open : uint8 (L,), not 1 while the path's light is not to be taken apart: it measures what the radiance cache
        lacks, has met a shadow catcher, or its ray of the Ambient Occlusion pass is under way
    kept : float32 (L, C), the path's radiance meanwhile
    value : float32 (3, C), a thread's scratch: of diffuse, glossy and transmission lobes
    color : float32 (3, 3), likewise, in RGB
    """

    #: There are as many light groups as the user likes.
    _dynamic = frozenset({"parts"})

    share: Float32Array
    parts: Float32Array
    group: Int32Array
    is_volume: Uint8Array
    is_open: Uint8Array
    kept: Float32Array
    value: Float32Array
    color: Float32Array


def allocate_light_pass_lanes(lane_count: int, channel_count: int, part_count: int) -> LightPassLanes:
    """Zeroed `LightPassLanes`; without parts none of them has lanes."""
    lanes = lane_count if part_count else 0
    return LightPassLanes(
        share=np.zeros((lanes, 2 * channel_count), np.float32),
        parts=np.zeros((lanes, channel_count * part_count), np.float32),
        group=np.full(lanes, -1, np.int32),
        is_volume=np.zeros(lanes, np.uint8),
        is_open=np.zeros(lanes, np.uint8),
        kept=np.zeros((lanes, channel_count), np.float32),
        value=np.zeros((3, value_width(channel_count)), np.float32),
        color=np.zeros((3, RGB), np.float32),
    )


#: FeatureLanes.throughput of a path whose features have been written.
FEATURES_DONE = np.float32(-1.0)


class FeatureLanes(Bundle):
    """What a path knows of the features for denoisers, L lanes, or one where there are none.

    throughput : float32 (L, 3), product of the albedos of the specular surfaces it has met, RGB; the first is
        FEATURES_DONE once it has met another one
    """

    throughput: Float32Array


def allocate_feature_lanes(lane_count: int) -> FeatureLanes:
    """Zeroed `FeatureLanes` for `lane_count` lanes."""
    return FeatureLanes(np.zeros((lane_count, RGB), np.float32))


class CatcherLanes(Bundle):
    """What a path knows of the shadow catcher that the camera's ray has met, L lanes, or one where there are none.

    base : float32 (L, C), radiance gathered before; alpha : float32 (L,), if the catcher were not there
    """

    base: Float32Array
    alpha: Float32Array


def allocate_catcher_lanes(lane_count: int, channel_count: int) -> CatcherLanes:
    """Zeroed `CatcherLanes` for `lane_count` lanes."""
    return CatcherLanes(np.zeros((lane_count, channel_count), np.float32), np.zeros(lane_count, np.float32))


class LightSamples(Bundle):
    """One light sample a lane, between choosing it and connecting to it.

    direction : float32 (L, 3), from the surface, unit; distance : float32, 1e30 for distant lights
    pdf : float32 [sr^-1], the tree's pmf included (a delta light's pmf); 0 = none
    radiance : float32 (L, C), or the factor on the light program's emission where there is a program
    terminate : float32 in [0, 1), for the roulette on dim light samples
    offset : float32 [m], rounding error of the point on the light along the ray
    emitter : int32, row of `LightArrays.emitters`, where LIGHT_ENDS_IN_PLACE
    flags : int32, LIGHT_*
    visibility : int32, RAY_* kinds that see this light
    bsdf_pdf : float32 [sr^-1], density of BSDF sampling in this direction
    guide_pdf : float32 [sr^-1], part of the source density that the guide has; bsdf_share : float32, factor on the
        BSDF's density in it (0 and 1 where the lane is not guided)
    weight : float32, 1 / probability of taking a sample at all, set before; 0 = not to be taken
    cluster : int32, of the light that was chosen, -1 = none; cluster_pmf, tree_pmf : float32, with which probability it
        was, and would have been by the light tree alone. Of lanes that are recorded, and of all where clamping has to
        know what learned choices have changed
    """

    _rows = True
    direction: Float32Array
    distance: Float32Array
    pdf: Float32Array
    radiance: Float32Array
    terminate: Float32Array
    offset: Float32Array
    emitter: Int32Array
    flags: Int32Array
    visibility: Int32Array
    bsdf_pdf: Float32Array
    guide_pdf: Float32Array
    bsdf_share: Float32Array
    weight: Float32Array
    cluster: Int32Array
    cluster_pmf: Float32Array
    tree_pmf: Float32Array
    channels: tuple[int, ...]


#: Light samples that are drawn at once.
DRAW_WIDTH = 8
# Columns of LightDraws.real. Numbers of a set:
DRAW_U_PICK = 0  # chooses the emitter
DRAW_U0 = 1
DRAW_U1 = 2
DRAW_ROULETTE = 3  # LightSamples.terminate
# the receiver, and the emitter that is chosen for it,
DRAW_P = 4
DRAW_N = 7
DRAW_TRANSMITS = 10  # 1, if it counts light from both sides, else 0
DRAW_PMF = 11
DRAW_IMPORTANCE = 12  # of up to eight emitters
# and the triangle, from a vertex as seen from the receiver by two edges, with the point that is drawn on it.
DRAW_TRIANGLE = 20
DRAW_PDF = 29
DRAW_DIRECTION = 30
DRAW_DISTANCE = 33
DRAW_U = 34
DRAW_V = 35
DRAW_REAL_WIDTH = 36

# Rows of LightDraws.hashes: what numbers follow from.
DRAW_RNG = 0
DRAW_SAMPLE = 1
DRAW_DIMENSION = 2

# Columns of LightDraws.integer.
DRAW_LANE = 0
DRAW_EMITTER = 1
DRAW_PATCH = 2
DRAW_LEAVES_DIM = 3
# Cell of the background's map; row -1: the sample is none of the whole map.
DRAW_ROW = 4
DRAW_COLUMN = 5
DRAW_INTEGER_WIDTH = 6


class LightDraws(Bundle):
    """A thread's scratch for what is drawn side by side: light samples, and the numbers of vertices.

    real : float32 (1, DRAW_REAL_WIDTH, DRAW_WIDTH)
    integer : int64 (DRAW_INTEGER_WIDTH, DRAW_WIDTH)
    hashes : uint32 (3, DRAW_WIDTH)
    """

    real: Float32Array
    integer: Int64Array
    hashes: Uint32Array


def allocate_light_draws() -> LightDraws:
    """Zeroed `LightDraws`."""
    size = 4 * DRAW_REAL_WIDTH * DRAW_WIDTH
    real = aligned_bytes(size)[:size].view(np.float32).reshape(1, DRAW_REAL_WIDTH, DRAW_WIDTH)
    return LightDraws(
        real, np.zeros((DRAW_INTEGER_WIDTH, DRAW_WIDTH), np.int64), np.zeros((3, DRAW_WIDTH), np.uint32)
    )


LIGHT_USES_MIS = 1
LIGHT_CASTS_SHADOW = 2
#: The program's emission at this sample is in the light closures.
LIGHT_HAS_PROGRAM = 4
#: Of a lamp, which is no surface: media go on up to it.
LIGHT_IS_LAMP = 8
#: Drawn for a whole segment within media: scattering finds the light as from another point.
LIGHT_IS_OF_SEGMENT = 16
#: Shadow rays end at it in place: a surface may lie there, or it is far from the origin.
LIGHT_ENDS_IN_PLACE = 32


def allocate_light_samples(lane_count: int, channel_count: int = 3) -> LightSamples:
    """Zeroed `LightSamples` for `lane_count` lanes."""
    real, integer = np.float32, np.int32
    fields = _records(
        lane_count,
        [
            [
                ("direction", real, 3),
                ("distance", real),
                ("pdf", real),
                ("radiance", real, channel_count),
                ("terminate", real),
                ("offset", real),
                ("flags", integer),
                ("visibility", integer),
                ("bsdf_pdf", real),
                ("guide_pdf", real),
                ("bsdf_share", real),
                ("weight", real),
            ],
            [("cluster", integer), ("cluster_pmf", real), ("tree_pmf", real), ("emitter", integer)],
        ],
    )
    fields["bsdf_share"][:] = fields["weight"][:] = 1.0
    return LightSamples(**fields, channels=tuple(range(channel_count)))


def allocate_paths(lane_count: int, channel_count: int = 3) -> PathState:
    """Zeroed `PathState` for `lane_count` lanes."""
    real, integer = np.float32, np.int32
    layout: list[list[tuple]] = [
        [
            ("origin", real, 3),
            ("direction", real, 3),
            ("time", real),
            ("flags", integer),
            ("hit_distance", real),
            ("hit_u", real),
            ("hit_v", real),
            ("hit_instance", integer),
            ("hit_triangle", integer),
            ("offset", real),
            ("reach", real),
            ("depth", np.int16),
            ("alive", np.uint8),
        ],
        [
            ("throughput", real, channel_count),
            ("radiance", real, channel_count),
            ("random", real, 4),
            ("rng", np.uint32),
            ("sample", integer),
            ("dimension", integer),
            ("pixel", integer),
            ("unguided", real),
            ("survival", real),
        ],
        [
            ("mis_origin", real, 3),
            ("mis_normal", real, 3),
            ("mis_distance", real),
            ("mis_pdf", real),
            ("unguided_pdf", real),
            ("unguided_survival", real),
            ("min_pdf", real),
            ("radius", real),
            ("spread", real),
            ("alpha", real),
            ("diffuse_depth", np.int16),
            ("glossy_depth", np.int16),
            ("transmission_depth", np.int16),
            ("transparent_depth", np.int16),
        ],
    ]
    if channel_count > RGB:
        layout.append([("wavelength", real, WAVELENGTHS), ("share", real, WAVELENGTHS), ("hero", real)])
    fields = _records(lane_count, layout)
    if channel_count == RGB:
        fields |= _without_wavelengths("hero")
    return PathState(**fields, channels=tuple(range(channel_count)))


def allocate_shadow_rays(lane_count: int, channel_count: int = 3) -> ShadowRays:
    """Zeroed `ShadowRays` for `lane_count` lanes."""
    real, integer = np.float32, np.int32
    fields = _records(
        lane_count,
        [
            [
                ("origin", real, 3),
                ("direction", real, 3),
                ("distance", real),
                ("radiance", real, channel_count),
                ("weight", real),
                ("own", real),
                ("other", real),
                ("share", real),
                ("lane", integer),
                ("transparent_depth", np.int16),
                ("transparent_left", np.int16),
            ]
        ],
    )
    return ShadowRays(**fields, channels=tuple(range(channel_count)))
