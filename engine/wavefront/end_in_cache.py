# SPDX-License-Identifier: GPL-3.0-or-later
"""Stages: end paths at surfaces whose light the radiance cache knows.

A path ends where it has spread: it has left a surface by a diffuse lobe, its footprint is larger than a share of that
of the camera's ray (Mueller et al. 2021, "Real-time Neural Radiance Caching for Path Tracing", Eq. 3, after Bekaert et
al. 2003, "A Custom Designed Density Estimation Method for Light Transport"), and the cell that is asked is smaller. So
it never ends at a surface that the camera sees, directly or in anything that reflects, nor in corners, where paths stay
close together. It ends before the surface is shaded: the cell knows what the surface sends back, texture, light
sampling and all.

In media paths go on. These spread footprints like surfaces, and a path that one has sent on may end at the next
surface.

Some paths go on all the same, chosen by their hash. They find what the cache should have said: it learns from those
that are recorded, and `accumulate` keeps the difference.
"""

import math

import numpy as np

from engine.guiding.fields.cells.field import SUM_WEIGHT, cell_key
from engine.guiding.fields.cells.query import first_level, is_small, look_up
from engine.kernels.bsdf import HAS_TRANSMISSION, HAS_TRANSPARENT, mean_roughness, summarize
from engine.kernels.bsdf.evaluate import is_delta_lobe
from engine.kernels.bsdf.kinds import SUBSURFACE
from engine.kernels.constants import FLOAT_MAX, FOUR_PI
from engine.kernels.lights import tree_of_receiver
from engine.kernels.path import real_3
from engine.kernels.prefetch import ask_for_history, ask_for_ray, ask_for_throughput, lane_ahead, prefetch
from engine.kernels.radiance import NO_GROUP, add_radiance, measured_group_count
from engine.kernels.rng import hash_combine
from engine.kernels.rounds import shape_at
from engine.kernels.vector import dot, load, store, subtract
from engine.runtime.jit import kernel
from engine.state.geometry import (
    INSTANCE_FLAG_HOLDOUT,
    INSTANCE_FLAGS,
    INSTANCE_MESH,
    MESH_SOLID,
    SHAPE_TRIANGLES,
)
from engine.state.group_parts import PARTS_MEASURED, SPLITS_MEASURED
from engine.state.lanes import (
    CACHE_VERTEX_BEFORE,
    CACHE_VERTEX_NG,
    CACHE_VERTEX_P,
    CACHE_VERTEX_RADIANCE,
    CACHE_VERTEX_SIDE,
    CLOSURE_SAMPLE_WEIGHT,
    MAX_CACHE_VERTICES,
    POINT_FLAG_BACKFACING,
    POINT_FLAGS,
    POINT_INSTANCE,
    POINT_NG,
    POINT_P,
    POINT_PROGRAM,
    RAY_CATCHER_HIT,
    RAY_DIFFUSE_ANCESTOR,
    RAY_SINGULAR,
    RAY_SUBSURFACE,
    RAY_TERMINATE_AFTER_TRANSPARENT,
    RAY_TERMINATE_ON_NEXT_SURFACE,
    RAY_VOLUME,
    RGB,
)
from engine.state.shaders import PROGRAM_FLAGS, PROGRAM_HAS_EMISSION, PROGRAM_MAY_BE_TRANSPARENT
from engine.wavefront.columns import CACHED_DEPTHS, CACHED_PATHS, UNIT_MEASURE_THRESHOLD, UNIT_SPLITS_LIGHT

#: Of the camera ray's footprint: paths end where theirs is larger (Mueller et al. 2021: 0.01).
_SPREAD = np.float32(0.01)
#: Scatterings that a path must have left for its surfaces behind the first possible end to teach the cache.
_FAR_LIMIT = 8
#: Surfaces that are smoother do not teach the cache: what they send back depends on where to.
_LEAST_ROUGHNESS = np.float32(0.1)
_LEAST_COSINE = np.float32(0.01)
#: What has to have sent a path on before it may end: a diffuse lobe once, or a medium last.
_SPREADS = RAY_DIFFUSE_ANCESTOR | RAY_VOLUME
#: Bits of a surface's shader in what cells tell surfaces apart by, and with the bit of its side.
_PROGRAM_BITS = 20
_SIDE_BITS = _PROGRAM_BITS + 1
_ENDS = RAY_TERMINATE_AFTER_TRANSPARENT | RAY_TERMINATE_ON_NEXT_SURFACE


@kernel
def is_cached_surface(scene, instance, program):
    """Whether cells may stand for surfaces of a shader: opaque ones that do not emit."""
    if scene.shaders.programs[program, PROGRAM_FLAGS] & (PROGRAM_HAS_EMISSION | PROGRAM_MAY_BE_TRANSPARENT):
        return False
    # Cells know surfaces by their normal, which says little of a strand.
    if shape_at(scene.geometry, instance) != SHAPE_TRIANGLES:
        return False
    return scene.geometry.instance_table[instance, INSTANCE_FLAGS] & INSTANCE_FLAG_HOLDOUT == 0


@kernel
def surface_kind(scene, points, lane):
    """What cells tell the surface that a lane has hit from others by: its shader, whether it is met from within what it
    encloses, and the lamps that may light it.

    Of a slab the inside faces the way that the outside across it does, and lies in one cell with that where the slab is
    thinner. What encloses nothing, as a lamp's shade, is open to both sides: they share cells, which know more then.
    """
    instance = np.int64(points.integer[lane, POINT_INSTANCE])
    tree = tree_of_receiver(scene.lights, instance)
    side = np.int64(0)
    if points.integer[lane, POINT_FLAGS] & POINT_FLAG_BACKFACING != 0:
        side = np.int64(scene.geometry.mesh_table[scene.geometry.instance_table[instance, INSTANCE_MESH], MESH_SOLID])
    return np.int64(points.integer[lane, POINT_PROGRAM]) + (side << _PROGRAM_BITS) + (tree << _SIDE_BITS)


@kernel
def footprint_root(origin, p, n, pdf):
    """What a path's way from `origin` to p adds to the square root of its footprint [m], if it was sent out with this
    density [sr^-1]: float32.
    """
    segment = subtract(p, origin)
    squared = dot(segment, segment)
    cosine = max(abs(dot(segment, n)) / math.sqrt(max(squared, np.float32(1e-30))), _LEAST_COSINE)
    return math.sqrt(squared / (pdf * cosine))


@kernel
def has_spread(cached, lane, root):
    """Whether a footprint is large enough for the path to end."""
    return root * root > _SPREAD * cached.seen[lane]


@kernel
def path_bits(paths, lane):
    """Number of a path, by which it is chosen to go on: uint32."""
    return hash_combine(paths.rng[lane], np.uint32(paths.sample[lane]))


@kernel
def _arrive(scene, paths, cached, points, lane):
    """Move the path's footprint to what it has hit; returns whether the cache may know that."""
    p, n = real_3(points, lane, POINT_P), real_3(points, lane, POINT_NG)
    cached.may_teach[lane] = 0
    if paths.flags[lane] & RAY_SUBSURFACE:
        # Cells know what surfaces send back, which is more than what they let out.
        return False
    cached.arriving[lane] = cached.root[lane]
    if paths.depth[lane] == 0:
        cached.seen[lane] = footprint_root(load(cached.origin, lane), p, n, FOUR_PI) ** 2
        return False
    if cached.pdf[lane] > 0.0:
        cached.arriving[lane] += footprint_root(load(cached.origin, lane), p, n, cached.pdf[lane])
    if not paths.flags[lane] & _SPREADS:
        return False
    # What catchers show is told from what they would show alone, and no path measures that.
    if paths.flags[lane] & (_ENDS | RAY_CATCHER_HIT) or not has_spread(cached, lane, cached.arriving[lane]):
        return False
    return is_cached_surface(scene, points.integer[lane, POINT_INSTANCE], points.integer[lane, POINT_PROGRAM])


@kernel
def _note(scene, paths, cached, points, lane):
    """Remember how a recorded path has arrived; whether the surface teaches is known once it is shaded."""
    vertex = cached.vertex_count[lane]
    if vertex >= MAX_CACHE_VERTICES:
        return
    cached.may_teach[lane] = 1
    row = lane * MAX_CACHE_VERTICES + vertex
    # Roulette has been played, but what it owes is settled later.
    inverse = 1.0 / min(paths.survival[lane], np.float32(1.0))
    for c in range(RGB):
        cached.vertices[row, CACHE_VERTEX_P + c] = points.real[lane, POINT_P + c]
        cached.vertices[row, CACHE_VERTEX_NG + c] = points.real[lane, POINT_NG + c]
        cached.vertices[row, CACHE_VERTEX_BEFORE + c] = paths.throughput[lane, c] * inverse
        cached.vertices[row, CACHE_VERTEX_RADIANCE + c] = paths.radiance[lane, c]
    cached.vertices[row, CACHE_VERTEX_SIDE] = cached.arriving[lane]
    cached.vertex_program[row] = surface_kind(scene, points, lane)


@kernel
def _cells_group(unit, paths, passes):
    """Light group that stands for cells: they do not know whose their light is."""
    if unit.header[UNIT_SPLITS_LIGHT] == SPLITS_MEASURED:
        return measured_group_count(paths.channels, passes)
    return NO_GROUP


@kernel
def end_in_cache(scene, unit, radiance, work, queue):
    """Look at paths that have hit a surface: end them, or note what they would have ended with.

    Parameters
    ----------
    radiance : RadianceView
        With the cells.
    queue : LaneQueue
        `work.surface`; the lanes that end are taken out.
    """
    options, cells = scene.options, radiance.cells
    paths, cached, points, contribution, passes = work.paths, work.cached, work.points, work.f_cos, work.passes
    threshold, group = unit.header[UNIT_MEASURE_THRESHOLD], _cells_group(unit, paths, passes)
    lanes, lane_count = queue.lanes, queue.count[0]
    # Nothing waits for shadows yet.
    asking, asking_count = work.pending.lanes, 0
    for k in range(lane_count):
        lane = lanes[k]
        ahead = lane_ahead(lanes, k, lane_count)
        ask_for_ray(paths, ahead)
        ask_for_history(paths, ahead)
        prefetch(points.real, ahead)
        prefetch(cached.depth, ahead)
        if not _arrive(scene, paths, cached, points, lane):
            continue
        is_first = cached.is_measured[lane] == 0
        if cached.is_recorded[lane] != 0:
            left = min(options.max_depth - paths.depth[lane], options.max_diffuse_depth - paths.diffuse_depth[lane])
            if cached.has_met[lane] == 0 or left >= _FAR_LIMIT:
                _note(scene, paths, cached, points, lane)
            cached.has_met[lane] = 1
        level = first_level(cells, cached.arriving[lane])
        if is_first and is_small(cells, level, cached.arriving[lane]):
            cached.level[lane] = level
            cached.place[lane], cached.tag[lane] = cell_key(
                cells, real_3(points, lane, POINT_P), real_3(points, lane, POINT_NG),
                surface_kind(scene, points, lane), level,
            )
            prefetch(cells.tag, cached.place[lane])
            asking[asking_count] = lane
            asking_count += 1
    for k in range(asking_count):
        lane = asking[k]
        ask_for_throughput(paths, lane_ahead(asking, k, asking_count))
        chosen = path_bits(paths, lane)
        slot = look_up(
            cells, cached.level[lane], cached.place[lane], cached.tag[lane], real_3(points, lane, POINT_P),
            real_3(points, lane, POINT_NG), surface_kind(scene, points, lane), cached.arriving[lane],
        )
        if slot < 0:
            continue
        survival = min(paths.survival[lane], np.float32(1.0))
        is_known = True
        for c in range(len(paths.channels)):
            value = np.float32(0.0)
            if paths.throughput[lane, c] > 0.0:
                # Not finite where no path has brought anything of this channel to the cell.
                weight = cells.sums[slot, SUM_WEIGHT + c] * survival
                value = paths.throughput[lane, c] * cells.sums[slot, c] / weight if weight > 0.0 else FLOAT_MAX
            # Written so that NaN fails. Lamps of negative strength take light.
            is_known = is_known and bool(abs(value) < FLOAT_MAX)
            contribution[lane, c] = value
            cached.base[lane, c] = paths.radiance[lane, c]
        if not is_known:
            continue
        work.counts[CACHED_PATHS + min(int(paths.depth[lane]), CACHED_DEPTHS) - 1] += 1
        # What the cell has learned from has been clamped.
        add_radiance(paths, passes, lane, contribution, lane, np.int64(paths.depth[lane]), 1.0, group)
        if np.int64(chosen) >= threshold:
            paths.alive[lane] = 0
            continue
        cached.is_measured[lane] = 1
        if unit.header[UNIT_SPLITS_LIGHT] != 0:
            passes.is_open[lane] = PARTS_MEASURED if group != NO_GROUP else 0
        for c in range(len(paths.channels)):
            cached.predicted[lane, c] = paths.radiance[lane, c] - cached.base[lane, c]
            paths.radiance[lane, c] = cached.base[lane, c]
    kept = 0
    for k in range(lane_count):
        lane = lanes[k]
        if paths.alive[lane] != 0:
            lanes[kept] = lane
            kept += 1
    queue.count[0] = kept


@kernel
def _teaches(closures, lane):
    """Whether what a shaded surface sends back is about the same in all directions: its lobes together are rough, those
    of mirrors counting as 0, and what comes out elsewhere as 1.
    """
    bits = summarize(closures, lane)
    if bits & (HAS_TRANSMISSION | HAS_TRANSPARENT):
        return False
    deep = np.float32(0.0)
    rough = np.float32(0.0)
    total = np.float32(0.0)
    for i in range(closures.count[lane]):
        weight = closures.param[lane, i, CLOSURE_SAMPLE_WEIGHT]
        total += weight
        if closures.kind[lane, i] == SUBSURFACE:
            deep += weight
        elif not is_delta_lobe(closures.kind, closures.param, lane, i):
            rough += weight
    return deep + rough > 0.0 and deep + mean_roughness(closures, lane) * rough >= _LEAST_ROUGHNESS * total


@kernel
def follow_footprints(scene, unit, work, queue):
    """Move the footprints of the paths that have been scattered on, and keep the surfaces that teach the cache.

    Parameters
    ----------
    queue : LaneQueue
        `work.surface`.
    """
    paths, cached, points, closures = work.paths, work.cached, work.points, work.closures
    lanes, lane_count = queue.lanes, queue.count[0]
    for k in range(lane_count):
        lane = lanes[k]
        ahead = lane_ahead(lanes, k, lane_count)
        ask_for_ray(paths, ahead)
        ask_for_history(paths, ahead)
        prefetch(cached.depth, ahead)
        # Paths that nothing came of count too: they have found nothing.
        if cached.may_teach[lane] != 0 and _teaches(closures, lane):
            cached.vertex_count[lane] += 1
        if paths.alive[lane] == 0 or paths.depth[lane] == cached.depth[lane]:
            continue
        cached.depth[lane] = paths.depth[lane]
        cached.root[lane] = cached.arriving[lane]
        store(cached.origin, lane, real_3(points, lane, POINT_P))
        cached.pdf[lane] = np.float32(0.0) if paths.flags[lane] & RAY_SINGULAR else paths.mis_pdf[lane]


@kernel
def follow_collisions(scene, unit, work, queue):
    """Move the footprints of the paths that media have sent on.

    Parameters
    ----------
    queue : LaneQueue
        `work.active`: guided collisions are in no other.
    """
    paths, cached, points = work.paths, work.cached, work.points
    lanes, lane_count = queue.lanes, queue.count[0]
    for k in range(lane_count):
        lane = lanes[k]
        if paths.alive[lane] == 0 or not paths.flags[lane] & RAY_VOLUME or paths.depth[lane] == cached.depth[lane]:
            continue
        p = real_3(points, lane, POINT_P)
        segment = subtract(p, load(cached.origin, lane))
        squared = dot(segment, segment)
        # A medium faces every ray.
        if cached.depth[lane] == 0:
            cached.seen[lane] = squared / FOUR_PI
        elif cached.pdf[lane] > 0.0:
            cached.root[lane] += math.sqrt(squared / cached.pdf[lane])
        cached.depth[lane] = paths.depth[lane]
        store(cached.origin, lane, p)
        share = work.media.collision_share[lane]
        cached.pdf[lane] = paths.mis_pdf[lane] / share if share > 0.0 else np.float32(0.0)
