# SPDX-License-Identifier: GPL-3.0-or-later
"""Stage: start new paths at the camera, in lanes that are free."""

import numpy as np

from engine.kernels.camera import generate_ray, sample_table, time_of_row
from engine.kernels.constants import ONE_MINUS_EPSILON
from engine.kernels.path_depths import reset_depths
from engine.kernels.prefetch import ask_for_history, ask_for_ray, ask_for_throughput
from engine.kernels.rng import SET_FILTER_LENS, SET_TIME, SETS_BEFORE_VERTICES, hash_combine, pixel_hash, sample_4d
from engine.kernels.rounding import floor_of
from engine.kernels.spectrum import start_wavelengths
from engine.kernels.vector import add, dot, scale, store
from engine.runtime.jit import kernel
from engine.spectral.wavelengths import WAVELENGTH_COUNT
from engine.state.lanes import RAY_CAMERA, RAY_MIS_SKIP, RAY_TRANSPARENT_BACKGROUND, RGB
from engine.state.unit import ALL_STRATA
from engine.wavefront.columns import (
    NEXT_PATH,
    UNIT_DIVIDES_WAVELENGTHS,
    UNIT_PATH_COUNT,
    UNIT_RECORD_THRESHOLD,
    UNIT_SAMPLE_FIRST,
    UNIT_SEED,
    UNIT_SPLITS_LIGHT,
    UNIT_STRATA,
    UNIT_STRATUM,
    UNIT_USE_DENOISING,
    UNIT_USES_CACHE,
)

_LANES_AHEAD = 4


@kernel
def place_in_stratum(u, piece_count, stratum, strata):
    """Move a number into a stratum, or tell which one it is in.

    Parameters
    ----------
    u : float32 in [0, 1)
    piece_count : int
        Equal parts of [0, 1), each of which has a piece of every stratum. Numbers stay in their part.
    stratum, strata : int
        As in `UnitView.header`.

    Returns
    -------
    u : float32 in [0, 1); stratum : int
    """
    part = np.float32(floor_of(u * np.float32(piece_count)))
    within = u * np.float32(piece_count) - part
    if stratum == ALL_STRATA:
        return u, np.int64(within * np.float32(strata))
    moved = (part + (np.float32(stratum) + within) / np.float32(strata)) / np.float32(piece_count)
    return min(moved, ONE_MINUS_EPSILON), stratum


@kernel
def _reset_cached(cached, lane, origin, is_recorded):
    """What the radiance cache knows of a path that begins."""
    cached.depth[lane] = 0
    store(cached.origin, lane, origin)
    cached.root[lane] = 0.0
    cached.pdf[lane] = 0.0
    cached.is_measured[lane] = 0
    cached.is_recorded[lane] = 1 if is_recorded else 0
    cached.has_met[lane] = 0
    cached.vertex_count[lane] = 0


@kernel
def init_from_camera(scene, unit, work, queue):
    """Fill free lanes with the unit's next paths.

    A pixel's numbers go by its place in the full image, so that a border does not change them. Paths whose hash is
    below the unit's UNIT_RECORD_THRESHOLD are recorded: 0 none, 2**32 all.

    Parameters
    ----------
    queue : LaneQueue
        `work.free`, a stack; `work.active` grows.
    """
    camera, motion, shutter, filter_table = scene.camera, scene.camera_motion, scene.shutter, scene.pixel_filter
    spectrum = scene.spectrum
    paths, log, header, pixels = work.paths, work.log, unit.header, unit.pixels
    # Without guiding only the cache learns, and has a log of its own.
    has_log = log.real.shape[0] > 1
    seed, sample_first, path_count = header[UNIT_SEED], header[UNIT_SAMPLE_FIRST], header[UNIT_PATH_COUNT]
    stratum, strata, divides_wavelengths = header[UNIT_STRATUM], header[UNIT_STRATA], header[UNIT_DIVIDES_WAVELENGTHS]
    record_threshold = header[UNIT_RECORD_THRESHOLD]
    use_denoising = header[UNIT_USE_DENOISING] != 0
    splits_light, passes = header[UNIT_SPLITS_LIGHT] != 0, work.passes
    uses_cache, cached = header[UNIT_USES_CACHE] != 0, work.cached
    free, free_count = queue.lanes, queue.count[0]
    active, active_count = work.active.lanes, work.active.count[0]
    next_path = work.counts[NEXT_PATH]
    pixel_count = pixels.shape[0]
    # Divided once, not for each path.
    pixel = next_path % pixel_count
    sample = sample_first + next_path // pixel_count
    while free_count > 0 and next_path < path_count:
        free_count -= 1
        lane, ahead = free[free_count], free[max(free_count - _LANES_AHEAD, 0)]
        ask_for_ray(paths, ahead)
        ask_for_throughput(paths, ahead)
        ask_for_history(paths, ahead)
        if pixel == pixel_count:
            pixel = 0
            sample += 1
        next_path += 1
        column = pixels[pixel, 0]
        row = pixels[pixel, 1]
        rng = pixel_hash(seed, column, row)
        u0, u1, u2, u3 = sample_4d(rng, sample, SET_FILTER_LENS)
        time_u, hero, _, _ = sample_4d(rng, sample, SET_TIME)
        row_of_film = pixel
        if strata > 1:
            if divides_wavelengths != 0:
                hero, found = place_in_stratum(hero, WAVELENGTH_COUNT, stratum, strata)
            else:
                time_u, found = place_in_stratum(time_u, 1, stratum, strata)
            if stratum == ALL_STRATA:
                row_of_film = pixel * strata + found
        time = time_of_row(camera, sample_table(shutter, time_u), row)
        x = np.float32(column) + 0.5 + sample_table(filter_table, u0)
        y = np.float32(row) + 0.5 + sample_table(filter_table, u1)
        origin, direction, near, far, radius, spread = generate_ray(camera, motion, x, y, u2, u3, time)
        paths.pixel[lane] = row_of_film
        paths.sample[lane] = sample
        paths.rng[lane] = rng
        paths.dimension[lane] = SETS_BEFORE_VERTICES
        start = add(origin, scale(direction, near))
        store(paths.origin, lane, start)
        store(paths.direction, lane, direction)
        paths.hit_distance[lane] = paths.reach[lane] = far - near
        paths.time[lane] = time
        for c in range(len(paths.channels)):
            paths.throughput[lane, c] = 1.0
            paths.radiance[lane, c] = 0.0
        if len(paths.channels) > RGB:
            start_wavelengths(spectrum, paths, lane, hero)
        paths.unguided[lane] = 1.0
        paths.survival[lane] = -1.0
        paths.unguided_survival[lane] = 1.0
        paths.mis_pdf[lane] = 0.0
        paths.unguided_pdf[lane] = -1.0
        store(paths.mis_origin, lane, start)
        store(paths.mis_normal, lane, direction)
        paths.mis_distance[lane] = 0.0
        paths.min_pdf[lane] = 1e30
        paths.radius[lane] = radius + near * spread
        paths.spread[lane] = spread
        paths.alpha[lane] = 1.0
        paths.flags[lane] = RAY_CAMERA | RAY_MIS_SKIP | RAY_TRANSPARENT_BACKGROUND
        reset_depths(paths, lane)
        # What a panorama's film does not see is black, and opaque.
        paths.alive[lane] = 1 if dot(direction, direction) > 0.0 else 0
        log.count[lane] = 0
        is_recorded = record_threshold > 0 and np.int64(hash_combine(rng, np.uint32(sample))) < record_threshold
        log.is_recording[lane] = 1 if is_recorded and has_log else 0
        if use_denoising:
            store(work.features.throughput, lane, (1.0, 1.0, 1.0))
        if splits_light:
            passes.is_open[lane] = 1
            for column in range(passes.parts.shape[1]):
                passes.parts[lane, column] = 0.0
        if uses_cache:
            _reset_cached(cached, lane, origin, is_recorded)
        active[active_count] = lane
        active_count += 1
        pixel += 1
    work.counts[NEXT_PATH] = next_path
    work.active.count[0] = active_count
    queue.count[0] = free_count
