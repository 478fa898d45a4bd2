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

from engine.guiding.fields.cells.field import SUM_WEIGHT, cell_size, find_known
from engine.guiding.records.vertices import MAX_VERTICES, VERTEX_CACHES
from engine.kernels.constants import FLOAT_MAX
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
#: Records that a cell must have.
_LEAST_COUNT = np.float32(128.0)
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
def _look_up(cells, p, n, footprint, bits):
    """A cell that knows enough and is no larger than the footprint [m^2]: its place, -1: none.

    The point is moved at random by up to half a cell, so that borders of cells do not show.
    """
    slot, level = find_known(cells, p, n, _LEAST_COUNT)
    if slot < 0:
        return slot
    size = cell_size(cells, level)
    if size * size > footprint:
        return np.int64(-1)
    tangent, bitangent = orthonormal_basis(n)
    u = (unit_float(hash_combine(bits, np.uint32(1))) - 0.5) * size
    v = (unit_float(hash_combine(bits, np.uint32(2))) - 0.5) * size
    other, other_level = find_known(cells, add(p, add(scale(tangent, u), scale(bitangent, v))), n, _LEAST_COUNT)
    return other if other >= 0 and other_level <= level else slot


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
    cached_count = 0
    for k in range(lane_count):
        lane = lanes[k]
        if paths.alive[lane] == 0 or paths.depth[lane] == cached.depth[lane]:
            continue
        cached.depth[lane] = paths.depth[lane]
        p, n = load(paths.mis_origin, lane), load(paths.mis_normal, lane)
        _spread(paths, cached, lane, p, n)
        flags = paths.flags[lane]
        if flags & (RAY_DIFFUSE | RAY_REFLECT) != RAY_DIFFUSE | RAY_REFLECT:
            continue
        if flags & (RAY_TERMINATE_AFTER_TRANSPARENT | RAY_TERMINATE_ON_NEXT_SURFACE):
            continue
        footprint = cached.root[lane] * cached.root[lane]
        has_spread = footprint > _SPREAD * cached.seen[lane]
        is_first = has_spread and cached.is_measured[lane] == 0
        if log.is_recording[lane] != 0 and log.count[lane] > 0:
            left = min(options.max_depth - paths.depth[lane], options.max_diffuse_depth - paths.diffuse_depth[lane])
            if is_first or left >= _FAR_LIMIT:
                log.real[lane * MAX_VERTICES + log.count[lane] - 1, VERTEX_CACHES] = 1.0
        if not is_first:
            continue
        bits = hash_combine(paths.rng[lane], np.uint32(paths.sample[lane]))
        slot = _look_up(cells, p, n, footprint, hash_combine(bits, np.uint32(paths.dimension[lane] + _SET_LOOKUP)))
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
        if np.int64(bits) >= threshold:
            paths.alive[lane] = 0
            continue
        cached.is_measured[lane] = 1
        for c in range(len(paths.channels)):
            cached.predicted[lane, c] = paths.radiance[lane, c] - cached.base[lane, c]
            paths.radiance[lane, c] = cached.base[lane, c]
    work.counts[CACHED_PATHS] += cached_count
