# SPDX-License-Identifier: GPL-3.0-or-later
"""Stages of the Ambient Occlusion pass, if it is asked for: how much of the hemisphere over a surface is free.

What the rays bring is gathered as the paths' radiance, which is set aside meanwhile.
"""

import math

import numpy as np

from engine.kernels.spectrum import to_rgb
from engine.runtime.jit import kernel
from engine.state.film import LIGHT_OCCLUSION
from engine.state.lanes import RAY_TRANSPARENT_BACKGROUND, RGB
from engine.wavefront.columns import SHADOW_ROWS
from engine.wavefront.hemisphere_rays import aim_ray, diffuse_normal, hidden_share, mean_hidden_share

#: Bit of `LightPassLanes.is_open` while a lane's ray is under way.
_IS_AIMED = 2


@kernel
def aim_occlusion(scene, unit, work, queue):
    """Queue a ray for every surface that the camera sees, and set the paths' radiance aside.

    Transparent surfaces count for as much as they hide.

    Parameters
    ----------
    queue : LaneQueue
        `work.surface`.
    """
    paths, closures, shadows, passes = work.paths, work.shaded, work.shadows, work.passes
    lanes, lane_count = queue.lanes, queue.count[0]
    row = 0
    for k in range(lane_count):
        lane = lanes[k]
        if paths.alive[lane] == 0 or not paths.flags[lane] & RAY_TRANSPARENT_BACKGROUND:
            continue
        aim_ray(scene, work, lane, row, diffuse_normal(closures, work.points, lane))
        mean = mean_hidden_share(closures, lane)
        for c in range(len(paths.channels)):
            shadows.radiance[row, c] = paths.throughput[lane, c] * hidden_share(paths, closures, lane, c, mean)
            passes.kept[lane, c] = paths.radiance[lane, c]
            paths.radiance[lane, c] = 0.0
        passes.is_open[lane] |= _IS_AIMED
        row += 1
    work.counts[SHADOW_ROWS] = row


@kernel
def keep_occlusion(scene, unit, work, queue):
    """Add what the rays have brought to the film, and give the paths their radiance back.

    Parameters
    ----------
    queue : LaneQueue
        Not looked at: rows of `work.shadows` tell the lanes.
    """
    paths, passes, film = work.paths, work.passes, unit.film
    for row in range(work.counts[SHADOW_ROWS]):
        lane = work.shadows.lane[row]
        color = to_rgb(scene.spectrum, paths, lane, paths.radiance, lane)
        if len(paths.channels) > RGB:
            # Grey: with wavelengths a colour is right on average only.
            grey = 0.0
            for c in range(len(paths.channels)):
                grey += paths.radiance[lane, c] / np.float32(len(paths.channels))
            color = (grey, grey, grey)
        for c in range(RGB):
            if math.isfinite(color[c]):
                film.light[paths.pixel[lane], LIGHT_OCCLUSION + c] += color[c]
        for c in range(len(paths.channels)):
            paths.radiance[lane, c] = passes.kept[lane, c]
        passes.is_open[lane] &= 1
