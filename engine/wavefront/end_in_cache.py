# SPDX-License-Identifier: GPL-3.0-or-later
"""Stage: end paths where the cache knows what they would still find.

A path ends at a diffuse scattering once it has spread: its footprint is larger than a share of that of the camera's ray
(Mueller et al. 2021, "Real-time Neural Radiance Caching for Path Tracing", Eq. 3, after Bekaert et al. 2003, "A Custom
Designed Density Estimation Method for Light Transport"), and larger than the cell that is asked. So it never ends at a
surface that the camera sees, directly or in mirrors and smooth glass, nor in corners, where paths stay close together.
The light sample of the vertex where it ends has been taken: the cache stands for what scattering finds.

Some paths go on all the same, chosen by their hash. They find what the cache should have said: it learns from those
that are recorded, and `accumulate` keeps the difference.
"""

import math

import numpy as np

from engine.guiding.fields.cells.field import (
    LEVEL_COUNT,
    SUM_COUNT,
    SUM_WEIGHT,
    cell_key,
    cell_size,
    find_cell,
)
from engine.guiding.records.vertices import MAX_VERTICES, VERTEX_CACHES
from engine.kernels.constants import FLOAT_MAX
from engine.kernels.prefetch import ask_for_history, ask_for_ray, ask_for_throughput, lane_ahead, prefetch
from engine.kernels.radiance import add_radiance
from engine.kernels.rng import hash_combine, unit_float
from engine.kernels.vector import add, dot, load, orthonormal_basis, scale, store, subtract
from engine.runtime.jit import kernel
from engine.state.lanes import (
    RAY_DIFFUSE,
    RAY_REFLECT,
    RAY_SINGULAR,
    RAY_TERMINATE_AFTER_TRANSPARENT,
    RAY_TERMINATE_ON_NEXT_SURFACE,
)
from engine.wavefront.columns import CACHED_PATHS, UNIT_MEASURE_THRESHOLD

#: Offset of the numbers for look-ups among a path's dimensions, far from those of its vertices.
_SET_LOOKUP = 1 << 18
#: Of the camera ray's footprint: paths end where theirs is larger (Mueller et al. 2021: 0.01).
_SPREAD = np.float32(0.01)
#: Side of the smallest cell that is asked, over that of the path's footprint: finer ones are noisier, and none sees it.
_FINEST_SHARE = np.float32(0.125)
#: Records that a cell must have.
_LEAST_COUNT = np.float32(32.0)
#: Scatterings that a path must have left for its vertices behind the first possible end to teach the cache.
_FAR_LIMIT = 8
_LEAST_COSINE = np.float32(0.01)
_FOUR_PI = np.float32(4.0 * math.pi)


@kernel
def _spread(paths, cached, lane, p, n):
    """Move the path's footprint on to its newest vertex."""
    segment = subtract(p, load(cached.origin, lane))
    squared = dot(segment, segment)
    cosine = max(abs(dot(segment, n)) / math.sqrt(max(squared, np.float32(1e-30))), _LEAST_COSINE)
    if paths.depth[lane] == 1:
        cached.seen[lane] = squared / (_FOUR_PI * cosine)
    elif cached.pdf[lane] > 0.0:
        cached.root[lane] += math.sqrt(squared / (cached.pdf[lane] * cosine))
    store(cached.origin, lane, p)
    cached.pdf[lane] = np.float32(0.0) if paths.flags[lane] & RAY_SINGULAR else paths.mis_pdf[lane]


@kernel
def _first_level(cells, side):
    """Level of the smallest cells that a path of a footprint of this side [m] asks."""
    level = 0
    while level + 1 < LEVEL_COUNT and cell_size(cells, level + 1) <= _FINEST_SHARE * side:
        level += 1
    return level


@kernel
def _moved(cells, p, n, level, bits):
    """The point along the surface, at random by up to half a cell, so that borders of cells do not show."""
    size = cell_size(cells, level)
    tangent, bitangent = orthonormal_basis(n)
    u = (unit_float(hash_combine(bits, np.uint32(1))) - 0.5) * size
    v = (unit_float(hash_combine(bits, np.uint32(2))) - 0.5) * size
    return add(p, add(scale(tangent, u), scale(bitangent, v)))


@kernel
def _look_up(cells, p, n, side, level, bits):
    """A cell that knows enough and is no larger than the path's footprint, from a level on; -1: none."""
    while level < LEVEL_COUNT and cell_size(cells, level) <= side:
        place, tag = cell_key(cells, _moved(cells, p, n, level, bits), n, level)
        slot = find_cell(cells, place, tag)
        if slot >= 0 and cells.sums[slot, SUM_COUNT] >= _LEAST_COUNT and cells.sums[slot, SUM_WEIGHT] > 0.0:
            return slot
        level += 1
    return np.int64(-1)


@kernel
def _could_end(options, paths, cached, log, lane):
    """Whether a path that has just been scattered could end; of a recorded one, note whether the vertex teaches."""
    p, n = load(paths.mis_origin, lane), load(paths.mis_normal, lane)
    _spread(paths, cached, lane, p, n)
    flags = paths.flags[lane]
    if flags & (RAY_DIFFUSE | RAY_REFLECT) != RAY_DIFFUSE | RAY_REFLECT:
        return False
    if flags & (RAY_TERMINATE_AFTER_TRANSPARENT | RAY_TERMINATE_ON_NEXT_SURFACE):
        return False
    has_spread = cached.root[lane] * cached.root[lane] > _SPREAD * cached.seen[lane]
    is_first = has_spread and cached.is_measured[lane] == 0
    if log.is_recording[lane] != 0 and log.count[lane] > 0:
        left = min(options.max_depth - paths.depth[lane], options.max_diffuse_depth - paths.diffuse_depth[lane])
        if is_first or left >= _FAR_LIMIT:
            log.real[lane * MAX_VERTICES + log.count[lane] - 1, VERTEX_CACHES] = 1.0
    return is_first


@kernel
def _numbers(paths, lane):
    """Of a path, by which it is chosen to go on; and of its newest vertex, for look-ups: uint32, uint32."""
    bits = hash_combine(paths.rng[lane], np.uint32(paths.sample[lane]))
    return bits, hash_combine(bits, np.uint32(paths.dimension[lane] + _SET_LOOKUP))


@kernel
def end_in_cache(scene, unit, radiance, work, queue):
    """Look at the queue's paths that have just been scattered: end them, or note what they would have ended with.

    Parameters
    ----------
    radiance : RadianceView
        With the cells.
    queue : LaneQueue
        `work.active`.
    """
    options, cells = scene.options, radiance.cells
    paths, cached, log, contribution = work.paths, work.cached, work.log, work.f_cos
    threshold = unit.header[UNIT_MEASURE_THRESHOLD]
    lanes, lane_count = queue.lanes, queue.count[0]
    # Nothing waits for shadows any more.
    asking, asking_count = work.pending.lanes, 0
    for k in range(lane_count):
        lane = lanes[k]
        ahead = lane_ahead(lanes, k, lane_count)
        ask_for_ray(paths, ahead)
        ask_for_history(paths, ahead)
        prefetch(cached.depth, ahead)
        if paths.alive[lane] == 0 or paths.depth[lane] == cached.depth[lane]:
            continue
        cached.depth[lane] = paths.depth[lane]
        if not _could_end(options, paths, cached, log, lane):
            continue
        _, bits = _numbers(paths, lane)
        level = _first_level(cells, cached.root[lane])
        n = load(paths.mis_normal, lane)
        place, _ = cell_key(cells, _moved(cells, load(paths.mis_origin, lane), n, level, bits), n, level)
        prefetch(cells.tag, place)
        asking[asking_count] = lane
        asking_count += 1
    cached_count = 0
    for k in range(asking_count):
        lane = asking[k]
        ask_for_throughput(paths, lane_ahead(asking, k, asking_count))
        chosen, bits = _numbers(paths, lane)
        side = cached.root[lane]
        level = _first_level(cells, side)
        slot = _look_up(cells, load(paths.mis_origin, lane), load(paths.mis_normal, lane), side, level, bits)
        if slot < 0:
            continue
        inverse = 1.0 / cells.sums[slot, SUM_WEIGHT]
        is_known = True
        for c in range(len(paths.channels)):
            value = paths.throughput[lane, c] * cells.sums[slot, c] * inverse
            # Written so that NaN fails.
            is_known = is_known and value >= 0.0 and value < FLOAT_MAX
            contribution[lane, c] = value
            cached.base[lane, c] = paths.radiance[lane, c]
        if not is_known:
            continue
        cached_count += 1
        add_radiance(options, paths, lane, contribution, lane, paths.depth[lane], 1.0)
        if np.int64(chosen) >= threshold:
            paths.alive[lane] = 0
            continue
        cached.is_measured[lane] = 1
        for c in range(len(paths.channels)):
            cached.predicted[lane, c] = paths.radiance[lane, c] - cached.base[lane, c]
            paths.radiance[lane, c] = cached.base[lane, c]
    work.counts[CACHED_PATHS] += cached_count
