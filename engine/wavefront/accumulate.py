# SPDX-License-Identifier: GPL-3.0-or-later
"""Stage: put finished paths on the film and free their lanes."""

import math

from engine.kernels.prefetch import ask_for_ray, ask_for_throughput, lane_ahead
from engine.kernels.spectrum import to_rgb
from engine.runtime.jit import kernel
from engine.state.lanes import RGB
from engine.wavefront.columns import REJECTS


@kernel
def accumulate(scene, unit, work, queue):
    """Keep living lanes in the queue; add the others to the film and free them.

    A sample with a NaN or infinite channel counts as black and as a reject.

    Parameters
    ----------
    queue : LaneQueue
        `work.active`.
    """
    spectrum, paths, film = scene.spectrum, work.paths, unit.film
    active, active_count = queue.lanes, queue.count[0]
    free, free_count = work.free.lanes, work.free.count[0]
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
        if finite:
            color = to_rgb(spectrum, paths, lane, paths.radiance, lane)
            for c in range(RGB):
                value = color[c]
                film.radiance[pixel, c] += value
                film.square[pixel, c] += value * value
            film.alpha[pixel] += paths.alpha[lane]
        else:
            reject_count += 1
        film.count[pixel] += 1
        free[free_count] = lane
        free_count += 1
    queue.count[0] = kept
    work.free.count[0] = free_count
    work.counts[REJECTS] += reject_count
