# SPDX-License-Identifier: GPL-3.0-or-later
"""Stages of the Ambient Occlusion pass, if it is asked for: how much of the hemisphere over a surface is free.

The rays take the place of the round's shadow rays, which have been traced: what they bring is gathered as the paths'
radiance, which is set aside meanwhile.
"""

import math

import numpy as np

from engine.kernels.bsdf.closures import average, read3
from engine.kernels.bsdf.kinds import LAST_DIFFUSE
from engine.kernels.bsdf.warp import sample_cosine_hemisphere
from engine.kernels.path import mark_shadow, real_3
from engine.kernels.spectrum import to_rgb
from engine.kernels.terminator import shadow_ray
from engine.kernels.vector import dot, normalize, store
from engine.runtime.jit import kernel
from engine.state.film import LIGHT_OCCLUSION
from engine.state.lanes import (
    CLOSURE_N,
    CLOSURE_WEIGHT,
    LIGHT_ENDS_IN_PLACE,
    POINT_FLAG_IN_PLACE,
    POINT_FLAGS,
    POINT_NG,
    POINT_NS,
    POINT_P,
    RAY_TRANSPARENT_BACKGROUND,
    RGB,
)
from engine.wavefront.columns import SHADOW_ROWS

#: Bit of `LightPassLanes.is_open` while a lane's ray is under way.
_IS_AIMED = 2


@kernel
def _diffuse_normal(closures, points, lane):
    """Mean normal of the lane's diffuse lobes, the smooth one where there are none."""
    x = y = z = np.float32(0.0)
    for i in range(closures.count[lane]):
        if closures.kind[lane, i] <= LAST_DIFFUSE:
            weight = average(read3(closures.param, lane, i, CLOSURE_WEIGHT))
            n = read3(closures.param, lane, i, CLOSURE_N)
            x, y, z = x + weight * n[0], y + weight * n[1], z + weight * n[2]
    if dot((x, y, z), (x, y, z)) > 0.0:
        return normalize((x, y, z))
    return real_3(points, lane, POINT_NS)


@kernel
def aim_occlusion(scene, unit, work, queue):
    """Queue a ray for every surface that the camera sees, and set the paths' radiance aside.

    Transparent surfaces count for as much as they hide.

    Parameters
    ----------
    queue : LaneQueue
        `work.surface`.
    """
    options, geometry, paths, points = scene.options, scene.geometry, work.paths, work.points
    closures, shadows, passes = work.shaded, work.shadows, work.passes
    lanes, lane_count = queue.lanes, queue.count[0]
    row = 0
    for k in range(lane_count):
        lane = lanes[k]
        if paths.alive[lane] == 0 or not paths.flags[lane] & RAY_TRANSPARENT_BACKGROUND:
            continue
        n = _diffuse_normal(closures, points, lane)
        wi, _ = sample_cosine_hemisphere(n, paths.random[lane, 1], paths.random[lane, 2])
        in_place = points.integer[lane, POINT_FLAGS] & POINT_FLAG_IN_PLACE != 0
        origin, wi, distance, in_place = shadow_ray(
            geometry, paths.hit_instance[lane], paths.hit_triangle[lane], paths.hit_u[lane], paths.hit_v[lane],
            real_3(points, lane, POINT_P), real_3(points, lane, POINT_NG), real_3(points, lane, POINT_NS), wi,
            options.occlusion_distance, paths.offset[lane], in_place, paths.time[lane],
        )
        mark_shadow(paths, lane, in_place)
        work.samples.flags[lane] &= ~LIGHT_ENDS_IN_PLACE
        work.samples.emitter[lane] = -1
        mean = 0.0
        for c in range(RGB):
            mean += min(max(1.0 - closures.transparency[lane, c], 0.0), 1.0) * (1.0 / RGB)
        for c in range(len(paths.channels)):
            hidden = mean
            if len(paths.channels) == RGB:
                hidden = min(max(1.0 - closures.transparency[lane, c], 0.0), 1.0)
            shadows.radiance[row, c] = paths.throughput[lane, c] * hidden
            passes.kept[lane, c] = paths.radiance[lane, c]
            paths.radiance[lane, c] = 0.0
        passes.is_open[lane] |= _IS_AIMED
        shadows.lane[row] = lane
        shadows.weight[row] = 1.0
        store(shadows.origin, row, origin)
        store(shadows.direction, row, wi)
        shadows.distance[row] = distance
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
