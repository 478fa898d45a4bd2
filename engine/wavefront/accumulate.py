# SPDX-License-Identifier: GPL-3.0-or-later
"""Stage: put finished paths on the film and free their lanes."""

import math

import numpy as np

from engine.kernels.prefetch import ask_for_ray, ask_for_throughput, lane_ahead
from engine.kernels.radiance import found_part, measured_group_count
from engine.kernels.rng import hash_combine
from engine.kernels.spectrum import to_rgb
from engine.runtime.jit import kernel
from engine.state.film import CAUGHT_ALONE, CAUGHT_COVER, CAUGHT_LIGHT, LIGHT_PARTS
from engine.state.group_parts import FOUND_SQUARE, FOUND_WIDTH, SPLITS_MEASURED
from engine.state.lanes import RAY_CATCHER_HIT, RGB
from engine.wavefront.columns import (
    REJECTS,
    UNIT_CATCHES,
    UNIT_FOLLOWS,
    UNIT_MEASURE_THRESHOLD,
    UNIT_SPLITS_LIGHT,
    UNIT_USES_CACHE,
)

#: Every second bit of a sample's index.
_CLASS_BITS = np.uint32(0xAAAAAAAA)


@kernel
def is_in_half(sample):
    """Whether a sample belongs to the half by which the picture's noise is told: bool.

    It does where an odd number of the index's odd bits are set. Each aligned group of four samples has two of them, and
    both halves of a scrambled Sobol sequence are about as well spread as the whole, which odd and even indices are not.

    References
    ----------
    Christensen et al. 2018, "Progressive Multi-Jittered Sample Sequences", section 10.2.1; Cycles' choice as well.
    """
    bits = np.uint32(np.uint32(sample) & _CLASS_BITS)
    bits = np.uint32(bits ^ (bits >> np.uint32(16)))
    bits = np.uint32(bits ^ (bits >> np.uint32(8)))
    bits = np.uint32(bits ^ (bits >> np.uint32(4)))
    bits = np.uint32(bits ^ (bits >> np.uint32(2)))
    return bits & np.uint32(2) != np.uint32(0)


@kernel
def _measured_half(paths, lane):
    """Which half of the measuring paths a path belongs to: 0 or 1."""
    return np.int64(hash_combine(paths.rng[lane], np.uint32(paths.sample[lane])) & np.uint32(1))


@kernel
def _keep_found(spectrum, paths, passes, lane, film, scale):
    """Have what a measuring path has found by light group count `scale` times, and keep one half of that and its
    squares.
    """
    pixel, count, first = paths.pixel[lane], len(paths.channels), found_part(paths.channels, passes)
    in_second = _measured_half(paths, lane) != 0
    column = LIGHT_PARTS + RGB * (passes.parts.shape[1] // count)
    for part in range(first, first + measured_group_count(paths.channels, passes) + 1):
        for c in range(count):
            passes.parts[lane, part * count + c] *= scale
            passes.value[0, c] = passes.parts[lane, part * count + c]
        color = to_rgb(spectrum, paths, lane, passes.value, 0)
        for c in range(RGB):
            if in_second:
                film.light[pixel, column + c] += color[c]
            film.light[pixel, column + FOUND_SQUARE] += color[c] * color[c] * np.float32(1.0 / RGB)
        column += FOUND_WIDTH


@kernel
def _take_cached(spectrum, paths, cached, lane, film, scale):
    """Leave a measuring path with the radiance that the cache gave it, and keep what that lacked, `scale` times."""
    for c in range(len(paths.channels)):
        cached.base[lane, c] += cached.predicted[lane, c]
        paths.radiance[lane, c] -= cached.base[lane, c]
    lacked = to_rgb(spectrum, paths, lane, paths.radiance, lane)
    half = _measured_half(paths, lane)
    if film.residual.shape[0] > 0:
        pixel = paths.pixel[lane]
        cached_color = to_rgb(spectrum, paths, lane, cached.base, lane)
        ended_color = to_rgb(spectrum, paths, lane, cached.predicted, lane)
        ended = gain = square = np.float32(0.0)
        for c in range(RGB):
            film.residual[pixel, RGB * half + c] += scale * lacked[c]
            ended += ended_color[c]
            gain += lacked[c] * (lacked[c] + np.float32(2.0) * cached_color[c])
            square += lacked[c] * lacked[c]
        of_mean = scale * np.float32(1.0 / RGB)
        film.ended[pixel] += of_mean * ended
        film.square_gain[pixel] += of_mean * gain
        film.residual_square[pixel] += scale * of_mean * square
    for c in range(len(paths.channels)):
        paths.radiance[lane, c] = cached.base[lane, c]


@kernel
def _keep_parts(spectrum, paths, passes, lane, film):
    """Add a path's parts to the film; `passes.value` is scratch."""
    pixel, count = paths.pixel[lane], len(paths.channels)
    for part in range(passes.parts.shape[1] // count):
        for c in range(count):
            passes.value[0, c] = passes.parts[lane, part * count + c]
        color = to_rgb(spectrum, paths, lane, passes.value, 0)
        for c in range(RGB):
            film.light[pixel, LIGHT_PARTS + RGB * part + c] += color[c]


@kernel
def _keep_caught(spectrum, paths, catcher, lane, film, follows):
    """Add the light of a shadow catcher to the film; `catcher.base` becomes it."""
    for c in range(len(paths.channels)):
        catcher.base[lane, c] = paths.radiance[lane, c] - catcher.base[lane, c]
    pixel, first = paths.pixel[lane], CAUGHT_ALONE if follows else CAUGHT_LIGHT
    color = to_rgb(spectrum, paths, lane, catcher.base, lane)
    for c in range(RGB):
        film.caught[pixel, first + c] += color[c]
    if not follows:
        film.caught[pixel, CAUGHT_COVER] += paths.alpha[lane] - catcher.alpha[lane]


@kernel
def accumulate(scene, unit, work, queue):
    """Keep living lanes in the queue; add the others to the film and free them.

    A sample with a NaN or infinite channel counts as black and as a reject; its alpha counts, as in Cycles. A path that
    measures the radiance cache counts as it would have ended there; what that lacked goes to the film's residual. A
    film that has a half gets half of the samples there too. Followers of shadow catchers count for nothing else.

    Parameters
    ----------
    queue : LaneQueue
        `work.active`.
    """
    spectrum, paths, film = scene.spectrum, work.paths, unit.film
    active, active_count = queue.lanes, queue.count[0]
    free, free_count = work.free.lanes, work.free.count[0]
    uses_cache, splits_light = unit.header[UNIT_USES_CACHE] != 0, unit.header[UNIT_SPLITS_LIGHT] != 0
    residual_scale = np.float32(2.0**32 / max(unit.header[UNIT_MEASURE_THRESHOLD], 1))
    catches, follows = unit.header[UNIT_CATCHES] != 0, unit.header[UNIT_FOLLOWS] != 0
    has_half = film.half.shape[0] > 0
    kept = 0
    reject_count = 0
    for k in range(active_count):
        lane = active[k]
        ahead = lane_ahead(active, k, active_count)
        ask_for_ray(paths, ahead)
        ask_for_throughput(paths, ahead)
        if paths.alive[lane] != 0:
            active[kept] = lane
            kept += 1
            continue
        pixel = paths.pixel[lane]
        finite = True
        for c in range(len(paths.channels)):
            finite = finite and math.isfinite(paths.radiance[lane, c])
        if catches and finite and paths.flags[lane] & RAY_CATCHER_HIT:
            _keep_caught(spectrum, paths, work.catcher, lane, film, follows)
        if follows:
            free[free_count] = lane
            free_count += 1
            continue
        is_halved = has_half and is_in_half(paths.sample[lane])
        if is_halved:
            film.half_weight[pixel] += np.float32(1.0)
        if finite and uses_cache and work.cached.is_measured[lane] != 0:
            _take_cached(spectrum, paths, work.cached, lane, film, residual_scale)
            if unit.header[UNIT_SPLITS_LIGHT] == SPLITS_MEASURED:
                _keep_found(spectrum, paths, work.passes, lane, film, residual_scale)
        if finite:
            color = to_rgb(spectrum, paths, lane, paths.radiance, lane)
            for c in range(RGB):
                value = color[c]
                film.radiance[pixel, c] += value
                film.square[pixel, c] += value * value
                if is_halved:
                    film.half[pixel, c] += value
            if splits_light:
                _keep_parts(spectrum, paths, work.passes, lane, film)
        else:
            reject_count += 1
        if math.isfinite(paths.alpha[lane]):
            film.alpha[pixel] += paths.alpha[lane]
        film.count[pixel] += 1
        free[free_count] = lane
        free_count += 1
    queue.count[0] = kept
    work.free.count[0] = free_count
    work.counts[REJECTS] += reject_count
