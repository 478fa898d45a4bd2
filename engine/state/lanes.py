# SPDX-License-Identifier: GPL-3.0-or-later
"""The one schema of per-path data: batches of lanes, one per thread, allocated once.

In memory a lane's fields lie side by side in whole cache lines (`line` of `column`), those that stages use together in
the same line: lanes in flight are visited in any order, and a stage should fetch few lines for each. In code every
field is an array of its own all the same, indexed by lane.

`channels` is a tuple whose *length* is the spectrum's width (3 for RGB, 4 for hero wavelengths). Numba types a tuple by
its length, so `for c in range(len(paths.channels))` unrolls and both widths live in one process. What only wavelengths
need stands behind `if len(paths.channels) > RGB:`, which costs an RGB render nothing; its fields have no lanes there.
"""

from __future__ import annotations

from typing import Any, NamedTuple, TypeVar

import numpy as np

from engine.array_types import Float32Array, Int16Array, Int32Array, Int64Array, Uint8Array, Uint32Array
from engine.runtime.bundle import Bundle
from engine.spectral.wavelengths import WAVELENGTH_COUNT as WAVELENGTHS
from engine.state.columns import RowLayout, aligned_bytes, allocate, column, without

#: Channels of a render without wavelengths.
RGB = 3

_Lanes = TypeVar("_Lanes", bound=Bundle)


class _Has(NamedTuple):
    """What lanes have (`engine.state.columns.Column.needs`)."""

    wavelengths: bool


def _allocate_lanes(table: type[_Lanes], lane_count: int, channel_count: int = RGB, **given: Any) -> _Lanes:
    """Lanes of L rows and C channels."""
    sizes = {
        "L": lane_count, "C": channel_count, "2 C": 2 * channel_count, "value": value_width(channel_count),
        "vertices": lane_count * MAX_CACHE_VERTICES,
    }
    return allocate(table, sizes, _Has(channel_count > RGB), **given)


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
RAY_EMISSION = 32768  # set by the shader's evaluation only: emission wanted, nothing else
RAY_PASSES_DONE = 65536  # passes of the first surface have been written
RAY_CATCHER_HIT = 131072  # the camera's ray has met a shadow catcher
#: The ray starts on the triangle that its path has hit, in place, and skips it.
RAY_STARTS_ON = 524288
#: The lane's shadow ray starts and ends in place, and skips the triangles there.
RAY_SHADOW_IN_PLACE = 1048576
RAY_SUBSURFACE = 2097152  # the path's hit is where it comes out from below a surface: diffuse, seen from outside
RAY_MIRRORS_DONE = 4194304  # what the path meets next is not seen in a mirror, nor through what is transparent
RAY_CAUSTIC, RAY_GATHERED = 1 << 23, 1 << 30  # photons find what the ray may find too (`kernels.caustics`)
RAY_TREE_SHIFT, RAY_TREE_MASK = 24, 63 << 24  # light tree of what has scattered the ray (kernels.lights.linking)

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
POINT_TANGENT = 18  # of curves: dP/du, world, not unit [m]; of the background: where a camera ray begins, world [m]
POINT_REAL_WIDTH = 21

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
POINT_FLAG_IN_PLACE = 2  # on an instance of INSTANCE_FLAG_IN_PLACE
POINT_FLAG_STRAND = 4  # on a curve


class ShadePoints(Bundle):
    """Points at which shader programs run: surface hits, light samples, background directions, shadow hits; L lanes."""

    _rows = True
    real: Float32Array = column("by POINT_*", "L", POINT_REAL_WIDTH, line=0)
    integer: Int32Array = column("by POINT_*", "L", POINT_INTEGER_WIDTH, line=0)


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
    """Weighted lobes, L lanes.

    `channels` is a tuple of ints, whose length is the spectrum's width.
    """

    _rows = True
    kind: Int32Array = column("engine.kernels.bsdf.kinds; in `param`", "L", MAX_CLOSURES)
    param: Float32Array = column("by CLOSURE_*", "L", MAX_CLOSURES, CLOSURE_WIDTH)
    count: Int32Array = column("lobes", "L", line=0)
    flags: Int32Array = column("CLOSURE_* bits of engine.kernels.bsdf.kinds", "L", line=0)
    holdout: Float32Array = column("weight of holdout closures", "L", line=0)
    ns: Float32Array = column(
        "smooth shading normal, before bump and normal maps (`bsdf.reset_closures` sets it)", "L", 3, line=0
    )
    emission: Float32Array = column("radiance emitted towards wo, per channel", "L", CLOSURE_CHANNELS, line=0)
    transparency: Float32Array = column("summed weight of transparent closures", "L", CLOSURE_CHANNELS, line=0)
    # Apart, so that shaders meet the same closures (`as_rgb`) and are not compiled again. Set where the lane disperses
    # (CLOSURE_DISPERSES), else not read.
    wavelength: Float32Array = column(
        "of the path, see `PathState` [nm]", "L", WAVELENGTHS, needs="wavelengths", record=1, line=0
    )
    share: Float32Array = column("likewise", "L", WAVELENGTHS, needs="wavelengths", record=1, line=0)
    dispersion: Float32Array = column(
        "of the material (`engine.spectral.dispersion`) [um^2]", "L", needs="wavelengths", record=1, line=0
    )
    aovs: Float32Array = column(
        "what programs leave for AOVs, A columns a lane (`DataOptions.aov_width`); camera rays only", "L A"
    )
    channels: tuple[int, ...]


def value_width(channel_count: int) -> int:
    """Columns that a BSDF's value takes: its channels; with wavelengths three times as many.

    The second third is the density by channel of lanes that disperse, the last is for work.
    """
    return channel_count if channel_count == RGB else 3 * channel_count


def allocate_points(lane_count: int) -> ShadePoints:
    """Zeroed `ShadePoints` for `lane_count` lanes."""
    return _allocate_lanes(ShadePoints, lane_count)


def allocate_closures(lane_count: int, channel_count: int = 3, aov_width: int = 0) -> Closures:
    """Zeroed `Closures` for `lane_count` lanes, at most `LANE_COUNT`, of a spectrum of `channel_count`.

    `aov_width` is the columns of all AOVs; closures without any must not meet camera rays and programs that have some.
    """
    if lane_count > LANE_COUNT:
        raise ValueError(f"closures for {lane_count} lanes: a batch has at most {LANE_COUNT}")
    memory = aligned_bytes(MAX_CLOSURES * _CLOSURE_LANES * CLOSURE_WIDTH * 4).view(np.float32)
    param = memory.reshape(MAX_CLOSURES, _CLOSURE_LANES, CLOSURE_WIDTH)[:, :lane_count].transpose(1, 0, 2)
    return _allocate_lanes(
        Closures, lane_count, channel_count, kind=param.view(np.int32)[:, :, _CLOSURE_KIND], param=param,
        # One element at least: that of an empty array has another stride, and so all kernels would be others.
        aovs=np.zeros(max(lane_count * aov_width, 1), np.float32), channels=tuple(range(channel_count)),
    )


def as_rgb(closures: Closures) -> Closures:
    """The same closures as shaders see them: their colours are RGB, whatever the render's spectrum."""
    if len(closures.channels) == RGB:
        return closures
    return closures._replace(**without(Closures, "wavelengths"), channels=tuple(range(RGB)))


# ---------------------------------------------------------------------------------------------------------------------
# Paths


class PathState(Bundle):
    """A batch of paths in flight, L lanes of C channels.

    `hit_*` is the closest hit. By plain sampling means where nothing has been learned: directions by the BSDF, roulette
    by the throughput. `channels` is a tuple of ints, whose length is the spectrum's width.
    """

    _rows = True
    origin: Float32Array = column("of the ray, world [m]", "L", 3, line=0)
    direction: Float32Array = column("of the ray, unit, world", "L", 3, line=0)
    time: Float32Array = column("in [0, 1], of the shutter", "L", line=0)
    flags: Int32Array = column("RAY_*", "L", line=0)
    hit_distance: Float32Array = column("before the search: how far to look [m]", "L", line=0)
    hit_u: Float32Array = column("barycentric", "L", line=0)
    hit_v: Float32Array = column("barycentric", "L", line=0)
    hit_instance: Int32Array = column("-1 = miss", "L", line=0)
    hit_triangle: Int32Array = column("row of GeometryArrays.triangles", "L", line=0)
    offset: Float32Array = column(
        "how far the next ray starts off the surface, to clear the rounding error of P [m]", "L", line=0
    )
    reach: Float32Array = column(
        "how far the ray goes from `mis_origin`: as far as the camera sees, or without an end [m]", "L", line=0
    )
    depth: Int16Array = column("scatterings so far", "L", line=0)
    alive: Uint8Array = column("0 once the path has ended in this round", "L", line=0)
    throughput: Float32Array = column("of the path so far", "L", "C", line=1)
    radiance: Float32Array = column("what the path has gathered so far", "L", "C", line=1)
    random: Float32Array = column(
        "this vertex's numbers for the BSDF; the last for roulette, then made uniform again", "L", 4, line=1
    )
    rng: Uint32Array = column("hash of (seed, pixel)", "L", line=1)
    sample: Int32Array = column("of the pixel", "L", line=1)
    dimension: Int32Array = column("next unused set of random numbers", "L", line=1)
    pixel: Int32Array = column("index into the film", "L", line=1)
    unguided: Float32Array = column(
        "factor that makes of the throughput what it would be by plain sampling; roulette and clamping go by it",
        "L", line=1,
    )
    survival: Float32Array = column(
        "probability with which roulette lets the path go on behind the next surface; before roulette is played the "
        "least that guiding asks for, -1 = nothing", "L", line=1,
    )
    mis_origin: Float32Array = column("where the light tree stood at the last scattering, world [m]", "L", 3, line=2)
    mis_normal: Float32Array = column("its normal there", "L", 3, line=2)
    mis_distance: Float32Array = column(
        "length of the ray since the last scattering, through transparent surfaces [m]", "L", line=2
    )
    mis_pdf: Float32Array = column(
        "density of the last scattering (source density), for MIS at the next emitter [sr^-1]; 0 of the camera's rays, "
        "which nothing is weighed against", "L", line=2,
    )
    unguided_pdf: Float32Array = column(
        "the same by plain sampling [sr^-1]; -1 where light sampling was of whole segments within media, whose samples "
        "know nothing of this scattering", "L", line=2,
    )
    unguided_survival: Float32Array = column("`survival` by plain sampling", "L", line=2)
    min_pdf: Float32Array = column("smallest scattering density so far (filter_glossy) [sr^-1]", "L", line=2)
    radius: Float32Array = column("compact ray differential: footprint at the origin [m]", "L", line=2)
    spread: Float32Array = column("growth of the footprint per metre", "L", line=2)
    alpha: Float32Array = column("1 - transparency seen by the camera so far", "L", line=2)
    diffuse_depth: Int16Array = column("scatterings by diffuse lobes", "L", line=2)
    glossy_depth: Int16Array = column("by glossy ones", "L", line=2)
    transmission_depth: Int16Array = column("by transmissive ones", "L", line=2)
    transparent_depth: Int16Array = column("transparent surfaces passed", "L", line=2)
    wavelength: Float32Array = column("hero first [nm]", "L", WAVELENGTHS, needs="wavelengths", line=3)
    share: Float32Array = column(
        "of each wavelength in the path's density: with which it would have been sampled, had that been the hero, over "
        "the sum of all", "L", WAVELENGTHS, needs="wavelengths", line=3,
    )
    hero: Float32Array = column("in [0, 1), by which wavelengths are drawn", "L", needs="wavelengths", line=3)
    channels: tuple[int, ...]


class ShadowRays(Bundle):
    """Light samples waiting for their visibility, at most one a lane.

    How many rows are in use is kept by the integrator. `channels` is as that of `PathState`.
    """

    _rows = True
    origin: Float32Array = column("of the ray, world [m]", "L", 3, line=0)
    direction: Float32Array = column("of the ray, unit, world", "L", 3, line=0)
    distance: Float32Array = column("to the light [m]", "L", line=0)
    radiance: Float32Array = column(
        "contribution if unoccluded, throughput and MIS weight included", "L", "C", line=0
    )
    weight: Float32Array = column(
        "what the sample counts for, since others are left out; clamping acts on `radiance` alone", "L", line=0
    )
    own: Float32Array = column("what clamping goes by (`engine.kernels.clamping.Unguided`)", "L", line=0)
    other: Float32Array = column("likewise", "L", line=0)
    share: Float32Array = column("likewise", "L", line=0)
    lane: Int32Array = column("the path that the row waits for", "L", line=0)
    transparent_depth: Int16Array = column(
        "transparent surfaces passed, the path's own included", "L", line=0
    )
    transparent_left: Int16Array = column("hits on what may be transparent that lie ahead", "L", line=0)
    channels: tuple[int, ...]


class GuidedLanes(Bundle):
    """What is decided for a lane before its light sample is weighed, L lanes."""

    rough_share: Float32Array = column(
        "probability of scattering off a lobe that is not delta, and resampling it; 0 = not guided, the BSDF samples "
        "all lobes", "L",
    )
    region: Int32Array = column("of the guiding field", "L")
    leaf: Int32Array = column("region that the point itself lies in", "L")
    candidate_count: Int32Array = column("directions to choose from", "L")
    probability: Float32Array = column("that the guide proposes a candidate, not the BSDF", "L")


def allocate_guided_lanes(lane_count: int) -> GuidedLanes:
    """`GuidedLanes` of which none is guided."""
    return _allocate_lanes(GuidedLanes, lane_count)


#: Surfaces at which a recorded path can teach the radiance cache.
MAX_CACHE_VERTICES = 12
_cache_vertex = RowLayout()  # of CachedLanes.vertices
CACHE_VERTEX_P = _cache_vertex.take(3)
CACHE_VERTEX_NG = _cache_vertex.take(3)
CACHE_VERTEX_BEFORE = _cache_vertex.take(3)  # throughput on arrival
CACHE_VERTEX_RADIANCE = _cache_vertex.take(3)  # the path's sum then
CACHE_VERTEX_SIDE = _cache_vertex.take()  # of its footprint
CACHE_VERTEX_WIDTH = _cache_vertex.width()


class CachedLanes(Bundle):
    """What a path knows of the radiance cache, L lanes."""

    _rows = True
    depth: Int32Array = column("of the path when it was last looked at", "L", line=0)
    origin: Float32Array = column("the vertex before, or the camera; world [m]", "L", 3, line=0)
    pdf: Float32Array = column(
        "with which that sent the path on, 0: by a delta lobe or the camera [sr^-1]", "L", line=0
    )
    seen: Float32Array = column("footprint of the camera's ray at the first surface [m^2]", "L", line=0)
    root: Float32Array = column("square root of the path's own footprint at the vertex before [m]", "L", line=0)
    arriving: Float32Array = column("and at the surface that it has hit [m]", "L", line=0)
    place: Int64Array = column("of the cell that is asked first", "L", line=0)
    tag: Uint32Array = column("of that cell", "L", line=0)
    level: Uint8Array = column("of that cell", "L", line=0)
    is_measured: Uint8Array = column("whether the path went on where it could have ended", "L", line=0)
    is_recorded: Uint8Array = column("whether the path teaches the cache", "L", line=0)
    has_met: Uint8Array = column("whether it has met a surface of which it could make a record", "L", line=0)
    may_teach: Uint8Array = column("whether the one that it has hit can be", "L", line=0)
    vertex_count: Int32Array = column("surfaces so far", "L", line=0)
    base: Float32Array = column("radiance gathered until there", "L", "C", line=0)
    predicted: Float32Array = column("what the path would have ended with", "L", "C", line=0)
    vertices: Float32Array = column("lane * MAX_CACHE_VERTICES + k, by CACHE_VERTEX_*", "vertices", CACHE_VERTEX_WIDTH)
    vertex_program: Int32Array = column("what cells tell the surface by (`surface_kind`), the same rows", "vertices")


def allocate_cached_lanes(lane_count: int, channel_count: int = 3) -> CachedLanes:
    """Zeroed `CachedLanes` for `lane_count` lanes."""
    return _allocate_lanes(CachedLanes, lane_count, channel_count)


# Parts that a path's light is taken apart into, by what it came by at the first surface (`LightPassLanes.parts`).
PART_DIFFUSE = 0  # direct, then indirect light, and so on
PART_GLOSSY = 2
PART_TRANSMISSION = 4
#: The parts of light groups follow; in scenes with media direct and indirect light by these come last.
PART_GROUPS = 6
VOLUME_PARTS = 2


class LightPassLanes(Bundle):
    """Light taken apart, L lanes of C channels; without light passes there are no parts."""

    share: Float32Array = column(
        "of diffuse lobes, then of glossy ones, in what the path carries since the first surface that has scattered "
        "it, or in that surface's light sample; transmission has the rest", "L", "2 C",
    )
    # There are as many light groups as the user likes.
    parts: Float32Array = column(
        "sums of the path's radiance by part (PART_*, then light groups), channels side by side", "L", "parts",
        is_dynamic=True,
    )
    group: Int32Array = column("light group of the lane's light sample, -1 = none", "L", fill=-1)
    is_volume: Uint8Array = column(
        "whether a medium was the first that has scattered the path, and has all of its light", "L"
    )
    is_open: Uint8Array = column(
        "not 1 while the path's light is not to be taken apart: it measures what the radiance cache lacks, has met a "
        "shadow catcher, or its ray of the Ambient Occlusion pass is under way", "L",
    )
    kept: Float32Array = column("the path's radiance meanwhile", "L", "C")
    value: Float32Array = column("a thread's scratch: of diffuse, glossy and transmission lobes", 3, "value")
    color: Float32Array = column("likewise, in RGB", 3, RGB)


def allocate_light_pass_lanes(lane_count: int, channel_count: int, part_count: int) -> LightPassLanes:
    """Zeroed `LightPassLanes`; without parts none of them has lanes."""
    lanes = lane_count if part_count else 0
    return _allocate_lanes(
        LightPassLanes, lanes, channel_count, parts=np.zeros((lanes, channel_count * part_count), np.float32)
    )


#: FeatureLanes.throughput of a path whose features have been written.
FEATURES_DONE = np.float32(-1.0)


class FeatureLanes(Bundle):
    """What a path knows of the features for denoisers, L lanes, or one where there are none."""

    throughput: Float32Array = column(
        "product of the albedos of specular surfaces met; the first is FEATURES_DONE behind another one", "L", RGB
    )
    mirrored: Float32Array = column("product of what surfaces met mirror and let through, from the first on", "L", RGB)


def allocate_feature_lanes(lane_count: int, mirror_lane_count: int) -> FeatureLanes:
    """Zeroed `FeatureLanes` for `lane_count` lanes, `mirrored` for `mirror_lane_count`."""
    return _allocate_lanes(FeatureLanes, lane_count, mirrored=np.zeros((mirror_lane_count, RGB), np.float32))


class CatcherLanes(Bundle):
    """What a path knows of the shadow catcher that the camera's ray has met, L lanes, or one where there are none."""

    base: Float32Array = column("radiance gathered before", "L", "C")
    alpha: Float32Array = column("if the catcher were not there", "L")


def allocate_catcher_lanes(lane_count: int, channel_count: int) -> CatcherLanes:
    """Zeroed `CatcherLanes` for `lane_count` lanes."""
    return _allocate_lanes(CatcherLanes, lane_count, channel_count)


class LightSamples(Bundle):
    """One light sample a lane, between choosing it and connecting to it, L lanes.

    `channels` is as that of `PathState`.
    """

    _rows = True
    direction: Float32Array = column("from the surface, unit", "L", 3, line=0)
    distance: Float32Array = column("1e30 for distant lights [m]", "L", line=0)
    pdf: Float32Array = column("the tree's pmf included (a delta light's pmf); 0 = none [sr^-1]", "L", line=0)
    radiance: Float32Array = column(
        "or the factor on the light program's emission where there is a program", "L", "C", line=0
    )
    terminate: Float32Array = column("in [0, 1), for the roulette on dim light samples", "L", line=0)
    offset: Float32Array = column("rounding error of the point on the light along the ray [m]", "L", line=0)
    flags: Int32Array = column("LIGHT_*", "L", line=0)
    visibility: Int32Array = column("RAY_* kinds that see this light", "L", line=0)
    bsdf_pdf: Float32Array = column("density of BSDF sampling in this direction [sr^-1]", "L", line=0)
    guide_pdf: Float32Array = column(
        "part of the source density that the guide has; 0 where the lane is not guided [sr^-1]", "L", line=0
    )
    bsdf_share: Float32Array = column(
        "factor on the BSDF's density in it; 1 where the lane is not guided", "L", fill=1.0, line=0
    )
    weight: Float32Array = column(
        "1 / probability of taking a sample at all, set before; 0 = not to be taken", "L", fill=1.0, line=0
    )
    # For lanes that are recorded, and for all where clamping has to know what learned choices have changed.
    cluster: Int32Array = column("of the light that was chosen, -1 = none", "L", line=1)
    cluster_pmf: Float32Array = column("probability with which it was", "L", line=1)
    tree_pmf: Float32Array = column("and with which it would have been by the light tree alone", "L", line=1)
    emitter: Int32Array = column("row of `LightArrays.emitters`", "L", line=1)
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
    """A thread's scratch for what is drawn side by side: light samples, and the numbers of vertices."""

    real: Float32Array = column("by DRAW_*", 1, DRAW_REAL_WIDTH, DRAW_WIDTH)
    integer: Int64Array = column("by DRAW_*", DRAW_INTEGER_WIDTH, DRAW_WIDTH)
    hashes: Uint32Array = column("by DRAW_RNG, DRAW_SAMPLE and DRAW_DIMENSION", 3, DRAW_WIDTH)


def allocate_light_draws() -> LightDraws:
    """Zeroed `LightDraws`."""
    real = aligned_bytes(4 * DRAW_REAL_WIDTH * DRAW_WIDTH).view(np.float32)
    return _allocate_lanes(LightDraws, 0, real=real.reshape(1, DRAW_REAL_WIDTH, DRAW_WIDTH))


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
    return _allocate_lanes(LightSamples, lane_count, channel_count, channels=tuple(range(channel_count)))


def allocate_paths(lane_count: int, channel_count: int = 3) -> PathState:
    """Zeroed `PathState` for `lane_count` lanes."""
    return _allocate_lanes(PathState, lane_count, channel_count, channels=tuple(range(channel_count)))


def allocate_shadow_rays(lane_count: int, channel_count: int = 3) -> ShadowRays:
    """Zeroed `ShadowRays` for `lane_count` lanes."""
    return _allocate_lanes(ShadowRays, lane_count, channel_count, channels=tuple(range(channel_count)))
