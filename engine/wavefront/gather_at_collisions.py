# SPDX-License-Identifier: GPL-3.0-or-later
"""Stages of paths where there are photons and media: gather marks of photons on segments, and say of paths that collide
which light photons find too.

Paths gather on each segment around a place where they would collide if they had to, as they sample its lights
(`engine.wavefront.light_segments`): in thin media few paths collide.

References: Jarosz, Zwicker and Jensen 2008, "The Beam Radiance Estimate for Volumetric Photon Mapping", of which this
takes a part of each segment by chance; Georgiev et al. 2012, Eq. (7); Knaus and Zwicker 2011, for radii in media
(`engine.render.photons_within`).
"""

import math
from typing import NamedTuple

import numpy as np

from engine.kernels.bsdf.phase import eval_phases
from engine.kernels.caustics import expected_photons
from engine.kernels.clamping import clamped_share, found_alone
from engine.kernels.collision import set_lobes
from engine.kernels.constants import INFINITY
from engine.kernels.gathered_photons import is_of_path, note_found
from engine.kernels.hash_grid import BLOCK_BITS, cell_of, first_of_block, occupied_of_block, place_in_block
from engine.kernels.media import emitted_length, length_in_media, sum_coefficients, transmittance, weigh_channels
from engine.kernels.path import real_3
from engine.kernels.photons_within import may_gather_within, mean_extinction, name_of_medium, ratio_within
from engine.kernels.prefetch import ask_for_history, ask_for_media, ask_for_ray, ask_for_throughput, lane_ahead
from engine.kernels.radiance import add_radiance
from engine.kernels.rng import SET_MEDIUM, hash_combine, sample_4d
from engine.kernels.vector import add, load, negate, scale
from engine.runtime.jit import kernel
from engine.state.lanes import POINT_INSTANCE, POINT_WO, RAY_GATHERED, RAY_VOLUME
from engine.state.media import CHANNEL_WEIGHT, EXTINCTION, SCATTERING
from engine.state.photons import (
    MAP_IS_TRIED,
    MAP_RADIUS,
    MAP_TUBE_BUCKETS,
    MAP_TUBE_INVERSE_CELL,
    MAP_TUBE_RADIUS,
    MAP_TUBE_SCALE,
    PHOTON_DENSITY,
    PHOTON_GROUP,
    PHOTON_MEDIUM,
    PHOTON_P,
    PHOTON_POWER,
    PHOTON_WI,
    TUBE_LENGTH,
    TUBE_ONE_IN,
)

_SUBSET_SEED = np.uint32(0x1B56C4E9)


class _Segment(NamedTuple):
    """A segment within media, and the cylinder about a place of it.

    t : float32, of the middle of the cylinder [m]; length : float32, of the segment [m]
    share : float32, probability that the path collides on it
    radius, half : float32, of the cylinder, and half of its length [m]
    extinction : float32, `mean_extinction` [m^-1]
    settled : float32, by what roulette multiplies what the path brings
    chosen : int, which marks of TUBE_ONE_IN are gathered
    is_tried, splits : bool, whether a trial, or passes, ask for each mark
    """

    t: np.float32
    length: np.float32
    share: np.float32
    radius: np.float32
    half: np.float32
    extinction: np.float32
    settled: np.float32
    chosen: np.int64
    is_tried: bool
    splits: bool


@kernel
def _draw_place(paths, media, lane, length, u_channel, u):
    """Where a path collides before `length`, by chance but for sure.

    Row CHANNEL_WEIGHT of the coefficients gets how likely each channel draws, their sum being that of a collision.

    Returns
    -------
    t : float32 [m]
    share : float32, probability of a collision; 0: there is no place
    """
    sums, channels = media.coefficients, paths.channels
    total, share = weigh_channels(paths, media, lane, length)
    colliding = share * total
    if not colliding > 0.0:
        return np.float32(0.0), np.float32(0.0)
    rest = u_channel * colliding
    extinction, part = np.float32(0.0), np.float32(0.0)
    for c in range(len(channels)):
        collides = np.float32(1.0) - transmittance(sums[EXTINCTION, c], length)
        weight = sums[CHANNEL_WEIGHT, c] * collides
        if weight > 0.0:
            extinction, part = sums[EXTINCTION, c], collides
            if rest < weight:
                break
            rest -= weight
    t = min(-np.float32(math.log(np.float32(1.0) - u * part)) / extinction, length)
    for c in range(len(channels)):
        sums[CHANNEL_WEIGHT, c] /= colliding
    return t, share


@kernel
def _draws_between(channels, sums, start, end):
    """Probability with which `_draw_place` draws a place between two distances [m]."""
    probability = np.float32(0.0)
    for c in range(len(channels)):
        extinction = sums[EXTINCTION, c]
        if extinction > 0.0:
            colliding = extinction * emitted_length(extinction, end - start) * transmittance(extinction, start)
            probability += sums[CHANNEL_WEIGHT, c] * colliding
    return probability


@kernel
def _add(options, work, lane, group):
    """Add row `lane` of `work.f_cos` as light that has come over surfaces to a collision."""
    paths, f_cos = work.paths, work.f_cos
    unguided, plain = paths.unguided[lane], paths.unguided_survival[lane]
    if plain > 0.0:
        unguided *= paths.survival[lane] / plain
    depth = np.int64(paths.depth[lane]) + 1
    share = clamped_share(options, paths.channels, f_cos, lane, depth, found_alone(unguided))
    add_radiance(paths, work.passes, lane, f_cos, lane, depth, share, group)


@kernel
def _extent(d, half, radius):
    """How far a cylinder reaches along an axis [m], d being its direction's part there."""
    return half * abs(d) + radius * math.sqrt(max(np.float32(1.0) - d * d, np.float32(0.0)))


@kernel
def _carried(paths, sums, lane, c, t):
    """What a channel of a path carries to where it is scattered, at a distance on its segment [m^-1]."""
    return paths.throughput[lane, c] * sums[SCATTERING, c] * transmittance(sums[EXTINCTION, c], t)


@kernel
def _segment_of(scene, work, lane, t, length, share, splits):
    """A lane's `_Segment`."""
    paths, numbers = work.paths, scene.photons.numbers
    radius = numbers[MAP_TUBE_RADIUS]
    hashed = hash_combine(paths.rng[lane] ^ _SUBSET_SEED, np.uint32(paths.sample[lane]))
    chosen = np.int64(hash_combine(hashed, np.uint32(paths.dimension[lane]))) % TUBE_ONE_IN
    return _Segment(
        np.float32(t), np.float32(length), np.float32(share), radius, np.float32(0.5 * TUBE_LENGTH) * radius,
        mean_extinction(paths.channels, work.media.coefficients),
        np.float32(1.0) / min(paths.survival[lane], np.float32(1.0)), chosen,
        scene.photons.header[MAP_IS_TRIED] != 0, splits,
    )


@kernel
def _gather_mark(scene, work, lane, row, segment, along, has_lobes):
    """What a mark brings that lies within the cylinder: three channels of light, 0 where it is not the path's.

    A mark counts as its own place on the segment does, over the probability with which the cylinder has it: along the
    segment nothing is blurred, nor lost at its ends.

    Parameters
    ----------
    segment : _Segment
    along : float32, of the mark from the middle of the cylinder [m]
    has_lobes : bool, whether the lane's closures are the medium's
    """
    grid, closures, paths, media = scene.photons, work.closures, work.paths, work.media
    photons, numbers, f_cos, sums = grid.within, grid.numbers, work.f_cos, work.media.coefficients
    if not has_lobes:
        set_lobes(scene, closures, media, lane)
    nothing = (np.float32(0.0), np.float32(0.0), np.float32(0.0))
    wi = (photons[row, PHOTON_WI], photons[row, PHOTON_WI + 1], photons[row, PHOTON_WI + 2])
    pdf = eval_phases(closures, lane, negate(load(paths.direction, lane)), wi, f_cos, lane)
    if not pdf > 0.0:
        return nothing
    at, half = segment.t + along, segment.half
    start, end = max(at - half, np.float32(0.0)), min(at + half, segment.length)
    reached = _draws_between(paths.channels, sums, start, end)
    if not reached > 0.0:
        return nothing
    ratio = ratio_within(numbers, segment.extinction, pdf, segment.share)
    expected = expected_photons(ratio, photons[row, PHOTON_DENSITY], numbers)
    # The cylinder is twice that long.
    alone = numbers[MAP_TUBE_SCALE] * segment.settled * np.float32(2.0) * half / reached
    factor = alone * expected / (np.float32(1.0) + expected)
    values = (
        factor * _carried(paths, sums, lane, 0, at) * f_cos[lane, 0] * photons[row, PHOTON_POWER],
        factor * _carried(paths, sums, lane, 1, at) * f_cos[lane, 1] * photons[row, PHOTON_POWER + 1],
        factor * _carried(paths, sums, lane, 2, at) * f_cos[lane, 2] * photons[row, PHOTON_POWER + 2],
    )
    if segment.is_tried or segment.splits:
        f_cos[lane, 0], f_cos[lane, 1], f_cos[lane, 2] = values
    if segment.is_tried:
        note_found(scene, work, lane, alone / factor, expected)
    if segment.splits:
        _add(scene.options, work, lane, np.int64(photons[row, PHOTON_GROUP]))
        return nothing
    return values


@kernel
def _gather_cell(scene, work, lane, cell, bucket, p, segment, has_lobes):
    """What the marks of a cell bring that lie within the cylinder: three channels, and whether there is any."""
    grid, paths = scene.photons, work.paths
    photons, inverse_cell, direction = grid.within, grid.numbers[MAP_TUBE_INVERSE_CELL], load(paths.direction, lane)
    radius, half, medium = segment.radius, segment.half, name_of_medium(work.media, lane)
    sum0, sum1, sum2 = np.float32(0.0), np.float32(0.0), np.float32(0.0)
    first, last = np.int64(grid.starts_within[bucket]), np.int64(grid.starts_within[bucket + 1])
    for row in range(first + (segment.chosen - first) % TUBE_ONE_IN, last, TUBE_ONE_IN):
        q = (photons[row, PHOTON_P], photons[row, PHOTON_P + 1], photons[row, PHOTON_P + 2])
        dx, dy, dz = q[0] - p[0], q[1] - p[1], q[2] - p[2]
        along = dx * direction[0] + dy * direction[1] + dz * direction[2]
        if abs(along) > half or dx * dx + dy * dy + dz * dz - along * along > radius * radius:
            continue
        if not 0.0 < segment.t + along < segment.length:
            continue
        if cell_of(q, inverse_cell) != cell:
            # Another cell that shares the bucket.
            continue
        if photons[row, PHOTON_MEDIUM] != medium or not is_of_path(scene.options, paths, lane, photons, row):
            continue
        value0, value1, value2 = _gather_mark(scene, work, lane, row, segment, along, has_lobes)
        has_lobes = True
        sum0 += value0
        sum1 += value1
        sum2 += value2
    return sum0, sum1, sum2, has_lobes


@kernel
def _gather(scene, work, lane, segment):
    """Add what marks bring that lie within the cylinder about a lane's segment, around a place that was drawn.

    Most have none near them: what blocks of cells hold any is asked first.
    """
    grid, paths, f_cos = scene.photons, work.paths, work.f_cos
    inverse_cell, buckets = grid.numbers[MAP_TUBE_INVERSE_CELL], grid.header[MAP_TUBE_BUCKETS]
    direction = load(paths.direction, lane)
    p = add(load(paths.origin, lane), scale(direction, segment.t))
    ex, ey, ez = (
        _extent(direction[0], segment.half, segment.radius), _extent(direction[1], segment.half, segment.radius),
        _extent(direction[2], segment.half, segment.radius),
    )  # fmt: skip
    x0, y0, z0 = cell_of((p[0] - ex, p[1] - ey, p[2] - ez), inverse_cell)
    x1, y1, z1 = cell_of((p[0] + ex, p[1] + ey, p[2] + ez), inverse_cell)
    sum0, sum1, sum2, has_lobes = np.float32(0.0), np.float32(0.0), np.float32(0.0), False
    for bz in range(z0 >> BLOCK_BITS, (z1 >> BLOCK_BITS) + 1):
        for by in range(y0 >> BLOCK_BITS, (y1 >> BLOCK_BITS) + 1):
            for bx in range(x0 >> BLOCK_BITS, (x1 >> BLOCK_BITS) + 1):
                block = first_of_block(bx, by, bz, 0, buckets - 1)
                occupied = occupied_of_block(grid.starts_within, buckets, block)
                if occupied == 0:
                    continue
                for z in range(max(z0, bz << BLOCK_BITS), min(z1 + 1, (bz + 1) << BLOCK_BITS)):
                    for y in range(max(y0, by << BLOCK_BITS), min(y1 + 1, (by + 1) << BLOCK_BITS)):
                        for x in range(max(x0, bx << BLOCK_BITS), min(x1 + 1, (bx + 1) << BLOCK_BITS)):
                            place = place_in_block(x, y, z)
                            if occupied >> place & 1 == 0:
                                continue
                            value0, value1, value2, has_lobes = _gather_cell(
                                scene, work, lane, (x, y, z), block + place, p, segment, has_lobes
                            )
                            sum0 += value0
                            sum1 += value1
                            sum2 += value2
    if sum0 + sum1 + sum2 > 0.0 and math.isfinite(sum0 + sum1 + sum2):
        f_cos[lane, 0], f_cos[lane, 1], f_cos[lane, 2] = sum0, sum1, sum2
        _add(scene.options, work, lane, -1)


@kernel
def gather_at_collisions(scene, unit, work, queue):
    """Add the light of marks that photons have left within media, on all segments on which paths may be scattered.

    Parameters
    ----------
    queue : LaneQueue
        `work.traced`, as `leave_segments` has left it.
    """
    if not scene.photons.numbers[MAP_RADIUS] > 0.0:
        # They have been given up.
        return
    options, paths, media, tried = scene.options, work.paths, work.media, work.photons.tried
    is_tried, splits = scene.photons.header[MAP_IS_TRIED] != 0, work.passes.parts.shape[0] > 0
    lanes, lane_count = queue.lanes, queue.count[0]
    for k in range(lane_count):
        lane = lanes[k]
        ahead = lane_ahead(lanes, k, lane_count)
        ask_for_ray(paths, ahead)
        ask_for_throughput(paths, ahead)
        ask_for_history(paths, ahead)
        ask_for_media(media, ahead)
        if paths.alive[lane] == 0 or media.is_lit[lane] == 0:
            continue
        # It has to leave the collision, and a sharp surface at least.
        if paths.depth[lane] + 2 > options.max_depth or media.depth[lane] + 1 >= options.max_volume_depth:
            continue
        if not may_gather_within(scene, media, lane):
            continue
        is_endless = paths.hit_instance[lane] < 0
        sum_coefficients(scene, paths, media, lane, lane, is_endless)
        length = INFINITY if is_endless else length_in_media(paths, media, lane)
        _, _, u_channel, u = sample_4d(paths.rng[lane], paths.sample[lane], paths.dimension[lane] + SET_MEDIUM)
        t, share = _draw_place(paths, media, lane, length, u_channel, u)
        if not share > 0.0:
            continue
        if is_tried and tried[paths.pixel[lane], 2] == 0.0:
            tried[paths.pixel[lane], 2] = paths.radius[lane] + t * paths.spread[lane]
        shows = splits and paths.depth[lane] == 0
        if shows:
            work.passes.is_volume[lane] = 1
        _gather(scene, work, lane, _segment_of(scene, work, lane, t, length, share, splits))
        if shows:
            work.passes.is_volume[lane] = 0


@kernel
def mark_collisions(scene, unit, work, queue):
    """Say of paths that have collided that photons find the light which they may meet over sharp surfaces.

    Parameters
    ----------
    queue : LaneQueue
        `work.active`: guided collisions are in no other.
    """
    numbers = scene.photons.numbers
    if not numbers[MAP_RADIUS] > 0.0:
        return
    paths, points, closures, media, f_cos = work.paths, work.points, work.closures, work.media, work.f_cos
    for k in range(queue.count[0]):
        lane = queue.lanes[k]
        # Of those that a medium has sent on, the others have met something since.
        has_collided = paths.flags[lane] & RAY_VOLUME != 0 and points.integer[lane, POINT_INSTANCE] < 0
        if paths.alive[lane] == 0 or not has_collided or paths.flags[lane] & RAY_GATHERED:
            continue
        if media.is_lit[lane] == 0 or not may_gather_within(scene, media, lane):
            continue
        sum_coefficients(scene, paths, media, lane, lane, False)
        wo, wi = real_3(points, lane, POINT_WO), load(paths.direction, lane)
        pdf = eval_phases(closures, lane, wo, wi, f_cos, lane)
        if pdf > 0.0:
            extinction = mean_extinction(paths.channels, media.coefficients)
            work.photons.ratio[lane] = ratio_within(numbers, extinction, pdf, media.collision_share[lane])
            paths.flags[lane] |= RAY_GATHERED
