# SPDX-License-Identifier: GPL-3.0-or-later
"""Stage: leave marks of photons on their segments within media, where paths gather them.

Each photon leaves several, independent of whether it goes on: marks are cheap beside photons, and in thin media few
photons collide.

References: Jensen and Christensen 1998, "Efficient Simulation of Light Transport in Scenes with Participating Media
using Photon Maps"; Jarosz et al. 2011, "A Comprehensive Theory of Volumetric Radiance Estimation
using Photon Points and Beams": what is gained by all places on a segment instead of one.
"""

import math

import numpy as np

from engine.kernels.constants import INFINITY
from engine.kernels.media import leave_objects, length_in_media, sum_coefficients, transmittance
from engine.kernels.photons_within import may_gather_within, name_of_medium
from engine.kernels.rng import SET_MEDIUM, sample_4d
from engine.kernels.vector import add, load, scale
from engine.runtime.jit import kernel
from engine.state.lanes import RAY_ENDS, RGB
from engine.state.media import CHANNEL_WEIGHT, EXTINCTION, SCATTERING
from engine.state.photons import (
    BOUNCE_LIMIT,
    IS_WITHIN,
    MAP_MARKS,
    PHOTON_BOUNCES,
    PHOTON_DENSITY,
    PHOTON_GROUP,
    PHOTON_IS_WITHIN,
    PHOTON_MEDIUM,
    PHOTON_P,
    PHOTON_POWER,
    PHOTON_SCATTERING,
    PHOTON_START,
    PHOTON_WI,
)
from engine.wavefront.columns import PHOTONS


@kernel
def _weigh_channels(paths, media, lane):
    """How likely each channel draws where marks are: by what of its light is scattered; the sum of these weights."""
    sums = media.coefficients
    total = np.float32(0.0)
    for c in range(len(paths.channels)):
        weight = np.float32(0.0)
        if sums[EXTINCTION, c] > 0.0:
            weight = abs(paths.throughput[lane, c]) * sums[SCATTERING, c] / sums[EXTINCTION, c]
        sums[CHANNEL_WEIGHT, c] = weight
        total += weight
    return total


@kernel
def _draw_extinction(channels, sums, rest):
    """The extinction of the channel in whose part of all weights `rest` is [m^-1]."""
    extinction = np.float32(0.0)
    for c in range(len(channels)):
        if sums[CHANNEL_WEIGHT, c] > 0.0:
            extinction = sums[EXTINCTION, c]
            if rest < sums[CHANNEL_WEIGHT, c]:
                break
            rest -= sums[CHANNEL_WEIGHT, c]
    return extinction


@kernel
def _leave_mark(work, lane, row, t, pdf):
    """Write what is left of the lane's photon at a distance, drawn with this density [m^-1], into a row."""
    paths, media, photons = work.paths, work.media, work.photons
    sums, found = media.coefficients, photons.found
    direction = load(paths.direction, lane)
    p = add(load(paths.origin, lane), scale(direction, t))
    scattering = np.float32(0.0)
    for k in range(RGB):
        found[row, PHOTON_P + k] = p[k]
        found[row, PHOTON_WI + k] = -direction[k]
        found[row, PHOTON_POWER + k] = paths.throughput[lane, k] * transmittance(sums[EXTINCTION, k], t) / pdf
        scattering += sums[SCATTERING, k] * np.float32(1.0 / 3.0)
    found[row, PHOTON_MEDIUM] = name_of_medium(media, lane)
    found[row, PHOTON_SCATTERING] = scattering
    found[row, PHOTON_IS_WITHIN] = IS_WITHIN
    found[row, PHOTON_DENSITY] = photons.density[lane]
    found[row, PHOTON_GROUP] = np.float32(photons.group[lane])
    passed = paths.depth[lane] - paths.glossy_depth[lane]
    found[row, PHOTON_BOUNCES] = np.float32(paths.glossy_depth[lane] + BOUNCE_LIMIT * passed)
    found[row, PHOTON_START] = np.float32(photons.start[lane])


@kernel
def keep_at_collisions(scene, unit, work, queue):
    """Leave marks where photons may collide before what they meet.

    Parameters
    ----------
    queue : LaneQueue
        `work.traced`: photons whose rays have been traced.
    """
    paths, media, sums = work.paths, work.media, work.media.coefficients
    most, kept = work.photons.found.shape[0], work.counts[PHOTONS]
    count = scene.photons.header[MAP_MARKS]
    step = np.float32(1.0) / np.float32(count)
    for k in range(queue.count[0]):
        lane = queue.lanes[k]
        is_endless = paths.hit_instance[lane] < 0
        if is_endless:
            leave_objects(media, lane)
        if paths.flags[lane] & RAY_ENDS or not may_gather_within(scene, media, lane):
            continue
        sum_coefficients(scene, paths, media, lane, lane, is_endless)
        total = _weigh_channels(paths, media, lane)
        if not total > 0.0:
            continue
        distance = INFINITY if is_endless else length_in_media(paths, media, lane)
        _, _, u_channel, u = sample_4d(paths.rng[lane], paths.sample[lane], paths.dimension[lane] + SET_MEDIUM)
        extinction = _draw_extinction(paths.channels, sums, u_channel * total)
        for mark in range(count):
            t = -math.log(np.float32(1.0) - (np.float32(mark) + u) * step) / extinction
            if not t < distance or kept >= most:
                break
            pdf = np.float32(0.0)
            for c in range(len(paths.channels)):
                pdf += sums[CHANNEL_WEIGHT, c] * sums[EXTINCTION, c] * transmittance(sums[EXTINCTION, c], t)
            pdf /= total
            if pdf > 0.0:
                _leave_mark(work, lane, kept, t, pdf)
                kept += 1
    work.counts[PHOTONS] = kept
