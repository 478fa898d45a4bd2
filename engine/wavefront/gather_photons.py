# SPDX-License-Identifier: GPL-3.0-or-later
"""Stages of paths where photons are: gather them at surfaces, and say which light photons find too.

References: Jensen 1996: the radiance estimate; Georgiev et al. 2012, Eq. (7); Hachisuka, Ogaki and Jensen 2008,
"Progressive Photon Mapping", and Knaus and Zwicker 2011: radii that shrink, so that the estimate converges
(`engine.render.photon_maps`).
"""

import math

import numpy as np

from engine.kernels.bsdf import DIFFUSE_LOBES, eval_bsdf, share_lobes
from engine.kernels.bsdf.evaluate import EVERY_KIND
from engine.kernels.caster_pieces import start_at
from engine.kernels.caustics import LEAST_COSINE, expected_photons, may_gather, ratio_at, sends_photons_on
from engine.kernels.clamping import clamped_share, found_alone
from engine.kernels.gathered_photons import is_of_path, note_found
from engine.kernels.hash_grid import bucket_of, cell_of
from engine.kernels.path import real_3
from engine.kernels.photon_motion import density_of_start, growth_at, resting_place
from engine.kernels.photon_windows import part_of_time, power_of_channel, window_weight
from engine.kernels.prefetch import ask_for_closures, ask_for_point, ask_for_ray, ask_for_throughput, lane_ahead
from engine.kernels.radiance import add_radiance
from engine.kernels.rng import hash_combine
from engine.kernels.vector import dot, load
from engine.runtime.jit import kernel
from engine.state.lanes import (
    POINT_NG,
    POINT_P,
    POINT_RADIUS,
    POINT_WO,
    RAY_CAUSTIC,
    RAY_DIFFUSE,
    RAY_GATHERED,
    RAY_REFLECT,
    RAY_SINGULAR,
    RAY_SUBSURFACE,
    RAY_TRANSPARENT,
    RGB,
)
from engine.state.photons import (
    MAP_BUCKETS,
    MAP_GATHERED_ONE_IN,
    MAP_HALF_TIME,
    MAP_HALF_WAVES,
    MAP_INVERSE_CELL,
    MAP_IS_TRIED,
    MAP_ONE_IN,
    MAP_PIXELS,
    MAP_RADIUS,
    MAP_SCALE,
    PHOTON_DENSITY,
    PHOTON_GROUP,
    PHOTON_MOVES,
    PHOTON_NG,
    PHOTON_POWER,
    PHOTON_TIME,
    PHOTON_WI,
)
from engine.wavefront.columns import UNIT_FOLLOWS
from engine.wavefront.disc_tries import FLATNESS, SAME_SURFACE, tries_in_disc

_SUBSET_SEED = np.uint32(0x3C6EF372)
_DISC_SEED = np.uint32(0x5BD1E995)


@kernel
def _may_go_on(options, diffuse_depth):
    """Whether a path that has been scattered so often diffusely may be once more, and then over a caster: photons are
    where paths would be.
    """
    return diffuse_depth + 1 < options.max_diffuse_depth


@kernel
def _add(options, paths, passes, lane, f_cos, group):
    """Add row `lane` of `f_cos` to the path as light that comes over several surfaces."""
    depth = np.int64(paths.depth[lane]) + 1
    share = clamped_share(options, paths.channels, f_cos, lane, depth, found_alone(paths.unguided[lane]))
    add_radiance(paths, passes, lane, f_cos, lane, depth, share, group)


@kernel
def _disc_of(header, numbers, paths, points, lane):
    """Within what a path gathers photons.

    What pixels next to each other gather alike are blotches, which no denoiser takes for noise. So one gets noise that
    is another in each pixel: a small disc, and few of its photons.

    Returns
    -------
    radius : float32 [m]
    one_in : int, of the photons there it gathers one in so many
    disc : float32, how many these are, over those that a path gathers within the map's radius
    """
    radius, pixel = numbers[MAP_RADIUS], numbers[MAP_PIXELS] * points.real[lane, POINT_RADIUS]
    gathered_one_in = header[MAP_GATHERED_ONE_IN]
    if not 0.0 < pixel < radius or paths.diffuse_depth[lane] > 0:
        return radius, gathered_one_in, np.float32(1.0)
    area = pixel * pixel / (radius * radius)
    one_in = header[MAP_ONE_IN]
    if one_in == 0:
        one_in = max(np.int64(np.float32(gathered_one_in) * area + np.float32(0.5)), np.int64(1))
    return pixel, one_in, area * np.float32(gathered_one_in) / np.float32(one_in)


@kernel
def _weight_of_time(grid, time, mover, part, row):
    """How often a photon counts for a path's time; 0 where it has arrived on something else that moves.

    Parameters
    ----------
    mover : float32, as PHOTON_MOVES; part : int, of the shutter, in which it is looked for
    """
    photons, half = grid.photons, grid.numbers[MAP_HALF_TIME]
    if not half > 0.0:
        return np.float32(1.0)
    if part_of_time(photons[row, PHOTON_TIME], half) != part or photons[row, PHOTON_MOVES] != mover:
        return np.float32(0.0)
    return window_weight(time, photons[row, PHOTON_TIME], half)


@kernel
def _powers(grid, paths, lane, row):
    """What a photon brings to each of a path's channels, the fourth 0 in RGB [W]."""
    photons = grid.photons
    if len(paths.channels) > RGB:
        hero, half = paths.hero[lane], grid.numbers[MAP_HALF_WAVES]
        return (
            power_of_channel(photons, row, hero, 0, half), power_of_channel(photons, row, hero, 1, half),
            power_of_channel(photons, row, hero, 2, half), power_of_channel(photons, row, hero, 3, half),
        )  # fmt: skip
    return photons[row, PHOTON_POWER], photons[row, PHOTON_POWER + 1], photons[row, PHOTON_POWER + 2], np.float32(0.0)


@kernel
def _lies_within(grid, row, cell, p, n, radius):
    """Whether a photon is in a cell, and within the disc of a place on a surface with that normal."""
    places, photons = grid.places, grid.photons
    q = (places[row, 0], places[row, 1], places[row, 2])
    dx, dy, dz = q[0] - p[0], q[1] - p[1], q[2] - p[2]
    if dx * dx + dy * dy + dz * dz > radius * radius:
        return False
    if cell_of(q, grid.numbers[MAP_INVERSE_CELL]) != cell:
        # Another cell that shares the bucket.
        return False
    if abs(dx * n[0] + dy * n[1] + dz * n[2]) > FLATNESS * radius:
        return False
    normal = (photons[row, PHOTON_NG], photons[row, PHOTON_NG + 1], photons[row, PHOTON_NG + 2])
    return bool(abs(dot(normal, n)) > SAME_SURFACE)


@kernel
def _gather(scene, work, lane):
    """Add what photons bring to a lane's surface."""
    grid, closures, paths, points = scene.photons, work.closures, work.paths, work.points
    photons, numbers = grid.photons, grid.numbers
    f_cos, splits = work.f_cos, work.passes.parts.shape[0] > 0
    wo, ng = real_3(points, lane, POINT_WO), real_3(points, lane, POINT_NG)
    p, n, mover, growth = resting_place(scene, paths, points, lane)
    time, half_time = paths.time[lane], numbers[MAP_HALF_TIME]
    first_part = part_of_time(max(time - half_time, np.float32(0.0)), half_time)
    parts = part_of_time(min(time + half_time, np.float32(1.0)), half_time) - first_part + 1
    radius, one_in, disc = _disc_of(grid.header, numbers, paths, points, lane)
    inverse_cell, is_tried = numbers[MAP_INVERSE_CELL], grid.header[MAP_IS_TRIED] != 0
    work.photons.disc[lane] = disc
    if is_tried and work.photons.tried[paths.pixel[lane], 2] == 0.0:
        work.photons.tried[paths.pixel[lane], 2] = points.real[lane, POINT_RADIUS]
    mask = grid.header[MAP_BUCKETS] - 1
    hashed = hash_combine(paths.rng[lane] ^ _SUBSET_SEED, np.uint32(paths.sample[lane]))
    chosen = np.int64(hash_combine(hashed, np.uint32(paths.dimension[lane]))) % one_in
    # Cells are at least twice as wide as the disc: eight hold it, or fewer.
    x0, y0, z0 = cell_of((p[0] - radius, p[1] - radius, p[2] - radius), inverse_cell)
    x1, y1, z1 = cell_of((p[0] + radius, p[1] + radius, p[2] + radius), inverse_cell)
    sum0, sum1, sum2, sum3 = np.float32(0.0), np.float32(0.0), np.float32(0.0), np.float32(0.0)
    tries, value3 = np.float32(0.0), np.float32(0.0)
    for corner in range(8 * parts):
        x, y, z = x0 + (corner & 1), y0 + (corner >> 1 & 1), z0 + (corner >> 2 & 1)
        if x > x1 or y > y1 or z > z1:
            continue
        part = first_part + (corner >> 3)
        bucket = bucket_of(x, y, z, part, mask)
        first, last = np.int64(grid.starts[bucket]), np.int64(grid.starts[bucket + 1])
        # Each photon of a bucket is in one of its parts.
        rows = last - first
        for row in range(first + chosen * rows // one_in, first + (chosen + 1) * rows // one_in):
            if not _lies_within(grid, row, (x, y, z), p, n, radius):
                continue
            weight, power = _weight_of_time(grid, time, mover, part, row), _powers(grid, paths, lane, row)
            if not weight * (power[0] + power[1] + power[2] + power[3]) > 0.0:
                continue
            if not is_of_path(scene.options, paths, lane, photons, row):
                continue
            wi = (photons[row, PHOTON_WI], photons[row, PHOTON_WI + 1], photons[row, PHOTON_WI + 2])
            pdf = eval_bsdf(closures, scene.tables, lane, wo, wi, ng, EVERY_KIND, f_cos, lane)
            cosine = max(abs(dot(ng, wi)), LEAST_COSINE)
            if not pdf > 0.0:
                continue
            share = growth * disc
            expected = expected_photons(share * ratio_at(ng, wi, pdf), photons[row, PHOTON_DENSITY], numbers)
            alone = weight * numbers[MAP_SCALE] / (cosine * share)
            factor = alone * expected / (np.float32(1.0) + expected)
            if tries == 0.0:
                seed = hash_combine(hashed ^ _DISC_SEED, np.uint32(paths.dimension[lane]))
                tries = tries_in_disc(scene, work, lane, real_3(points, lane, POINT_P), ng, radius, seed)
            factor *= tries
            value0 = factor * paths.throughput[lane, 0] * f_cos[lane, 0] * power[0]
            value1 = factor * paths.throughput[lane, 1] * f_cos[lane, 1] * power[1]
            value2 = factor * paths.throughput[lane, 2] * f_cos[lane, 2] * power[2]
            if len(paths.channels) > RGB:
                value3 = factor * paths.throughput[lane, 3] * f_cos[lane, 3] * power[3]
                f_cos[lane, 3] = value3
            if is_tried:
                f_cos[lane, 0], f_cos[lane, 1], f_cos[lane, 2] = value0, value1, value2
                note_found(scene, work, lane, alone / factor, expected)
            if splits:
                if paths.depth[lane] == 0:
                    passes = work.passes
                    share_lobes(closures, lane, wo, wi, EVERY_KIND, DIFFUSE_LOBES, passes.value, passes.share)
                f_cos[lane, 0], f_cos[lane, 1], f_cos[lane, 2] = value0, value1, value2
                _add(scene.options, paths, work.passes, lane, f_cos, np.int64(photons[row, PHOTON_GROUP]))
            else:
                sum0 += value0
                sum1 += value1
                sum2 += value2
                sum3 += value3
    total = sum0 + sum1 + sum2 + sum3
    if not splits and total > 0.0 and math.isfinite(total):
        f_cos[lane, 0], f_cos[lane, 1], f_cos[lane, 2] = sum0, sum1, sum2
        if len(paths.channels) > RGB:
            f_cos[lane, 3] = sum3
        _add(scene.options, paths, work.passes, lane, f_cos, -1)


@kernel
def _counts(scene, unit):
    """Whether photons are there for a unit's paths: not where they have been given up, and not for followers, who see
    shadow catchers alone and no casters.
    """
    return scene.photons.numbers[MAP_RADIUS] > 0.0 and unit.header[UNIT_FOLLOWS] == 0


@kernel
def gather_photons(scene, unit, work, queue):
    """Add the light of photons at surfaces that gather them.

    Parameters
    ----------
    queue : LaneQueue
        `work.surface`, shaded.
    """
    if not _counts(scene, unit):
        return
    paths, points, closures = work.paths, work.points, work.closures
    lanes, lane_count = queue.lanes, queue.count[0]
    for k in range(lane_count):
        lane = lanes[k]
        ahead = lane_ahead(lanes, k, lane_count)
        ask_for_ray(paths, ahead)
        ask_for_throughput(paths, ahead)
        ask_for_point(points, ahead)
        ask_for_closures(closures, ahead)
        if paths.alive[lane] == 0 or not _may_go_on(scene.options, paths.diffuse_depth[lane]):
            continue
        if may_gather(scene, closures, lane, np.int64(paths.hit_instance[lane])):
            _gather(scene, work, lane)


@kernel
def mark_caustics(scene, unit, work, queue):
    """Say of paths that have just been scattered whether photons find the light that they may meet next.

    Parameters
    ----------
    queue : LaneQueue
        `work.surface`, from which paths have gone on.
    """
    if not _counts(scene, unit):
        return
    paths, points, closures, f_cos = work.paths, work.points, work.closures, work.f_cos
    photons, grid = work.photons, scene.photons
    is_tried = grid.header[MAP_IS_TRIED] != 0
    lanes, lane_count = queue.lanes, queue.count[0]
    for k in range(lane_count):
        lane = lanes[k]
        ahead = lane_ahead(lanes, k, lane_count)
        ask_for_ray(paths, ahead)
        ask_for_point(points, ahead)
        ask_for_closures(closures, ahead)
        flags = paths.flags[lane]
        if paths.alive[lane] == 0 or flags & RAY_TRANSPARENT:
            continue
        instance = np.int64(paths.hit_instance[lane])
        if flags & RAY_SUBSURFACE:
            # It has gone in below the surface, and gathers where it comes out.
            continue
        if flags & RAY_SINGULAR or (flags & RAY_GATHERED and sends_photons_on(closures, lane)):
            if flags & RAY_GATHERED:
                start = start_at(scene.casters, paths, points, lane, load(paths.direction, lane))
                if start >= 0:
                    flags |= RAY_CAUSTIC
                    photons.place_density[lane] = density_of_start(
                        scene, start, instance, np.int64(paths.hit_triangle[lane]), paths.time[lane]
                    )
                    if is_tried:
                        photons.seen[start] += np.float32(1.0)
        else:
            was_diffuse = flags & RAY_DIFFUSE != 0 and flags & RAY_REFLECT != 0
            before = np.int64(paths.diffuse_depth[lane]) - (1 if was_diffuse else 0)
            flags &= ~RAY_GATHERED
            if _may_go_on(scene.options, before) and may_gather(scene, closures, lane, instance):
                wo, ng = real_3(points, lane, POINT_WO), real_3(points, lane, POINT_NG)
                wi = load(paths.direction, lane)
                pdf = eval_bsdf(closures, scene.tables, lane, wo, wi, ng, EVERY_KIND, f_cos, lane)
                if pdf > 0.0:
                    flags |= RAY_GATHERED
                    growth = growth_at(scene, instance, np.int64(paths.hit_triangle[lane]), paths.time[lane])
                    photons.ratio[lane] = growth * photons.disc[lane] * ratio_at(ng, wi, pdf)
        paths.flags[lane] = flags
