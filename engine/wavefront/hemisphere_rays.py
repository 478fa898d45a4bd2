# SPDX-License-Identifier: GPL-3.0-or-later
"""Rays over a surface's hemisphere that take the place of a round's shadow rays, which have been traced."""

import numpy as np

from engine.kernels.bsdf.closures import average, read3
from engine.kernels.bsdf.kinds import FIRST_HAIR
from engine.kernels.bsdf.portal import passed_share
from engine.kernels.bsdf.warp import sample_cosine_hemisphere
from engine.kernels.clamping import found_alone
from engine.kernels.pass_surface import mean_transparency
from engine.kernels.path import mark_shadow, real_3
from engine.kernels.terminator import shadow_ray
from engine.kernels.vector import dot, normalize, store
from engine.runtime.jit import kernel
from engine.state.lanes import (
    CLOSURE_N,
    CLOSURE_WEIGHT,
    LIGHT_ENDS_IN_PLACE,
    POINT_FLAG_IN_PLACE,
    POINT_FLAGS,
    POINT_NG,
    POINT_NS,
    POINT_P,
    RGB,
)


@kernel
def diffuse_normal(closures, points, lane):
    """Mean normal of the lane's diffuse lobes, fibres not among them; the smooth one where there are none."""
    x = y = z = np.float32(0.0)
    for i in range(closures.count[lane]):
        if closures.kind[lane, i] < FIRST_HAIR:
            weight = average(read3(closures.param, lane, i, CLOSURE_WEIGHT))
            n = read3(closures.param, lane, i, CLOSURE_N)
            x, y, z = x + weight * n[0], y + weight * n[1], z + weight * n[2]
    if dot((x, y, z), (x, y, z)) > 0.0:
        return normalize((x, y, z))
    return real_3(points, lane, POINT_NS)


@kernel
def diffuse_weight(closures, lane, channel):
    """Sum of the weights of the lane's diffuse lobes in a channel: float32."""
    weight = np.float32(0.0)
    for i in range(closures.count[lane]):
        if closures.kind[lane, i] < FIRST_HAIR:
            weight += closures.param[lane, i, CLOSURE_WEIGHT + channel]
    return weight


@kernel
def hidden_share(paths, closures, lane, channel, mean):
    """How much of what is behind a surface it hides, in a channel; `mean` over RGB with wavelengths."""
    if len(paths.channels) == RGB:
        return 1.0 - passed_share(closures, lane, channel)
    return mean


@kernel
def mean_hidden_share(closures, lane):
    """How much of what is behind a surface it hides, mean over RGB."""
    return 1.0 - mean_transparency(closures, lane)


@kernel
def aim_ray(scene, work, lane, row, n):
    """Set up row `row` of `work.shadows` for a ray of the hemisphere over the normal `n`, all but its radiance.

    Its direction follows the cosine, by the numbers that the BSDF is sampled with. It looks as far as
    `IntegratorOptions.occlusion_distance`. No light sample of before has a say in how it is clamped or what blocks it.
    """
    options, geometry, paths, points, shadows = scene.options, scene.geometry, work.paths, work.points, work.shadows
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
    unguided = found_alone(paths.unguided[lane])
    shadows.own[row], shadows.other[row], shadows.share[row] = unguided.own, unguided.other, unguided.share
    shadows.lane[row] = lane
    shadows.weight[row] = 1.0
    store(shadows.origin, row, origin)
    store(shadows.direction, row, wi)
    shadows.distance[row] = distance
