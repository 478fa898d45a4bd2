# SPDX-License-Identifier: GPL-3.0-or-later
"""Stages: what surfaces mirror, for denoisers. Run only if one of these passes was asked for.

Of the first surfaces they write how much and how sharply these mirror. Then, for denoisers that look at the frame
before, the motion of what is mirrored: of what lies behind the first scattering, if that was a reflection at a surface
that is a mirror for more than half, or is transparent in part. All as in Cycles (`engine.kernels.bsdf.mirrors`).
"""

import math

import numpy as np

from engine.kernels.bsdf.mirrors import sum_mirrors
from engine.kernels.pass_vectors import reflected_motion
from engine.kernels.path import real_3
from engine.kernels.vector import add, load, multiply, scale, store
from engine.runtime.jit import kernel
from engine.state.lanes import (
    POINT_INSTANCE,
    POINT_P,
    POINT_TRIANGLE,
    POINT_U,
    POINT_V,
    POINT_WO,
    RAY_ENDS,
    RAY_MIRRORS_DONE,
    RAY_REFLECT,
    RAY_SUBSURFACE,
)

#: Brightest channel up to which nothing mirrored or let through is seen.
_LEAST_SEEN = np.float32(1e-4)


@kernel
def _write_mirrors(options, film, pixel, specular, roughness, through, share):
    """Add albedo of specular lobes and roughness to the film, seen `through` what is before, as `share` samples."""
    seen = scale(multiply(specular, through), share)
    if options.specular_albedo >= 0 and math.isfinite(seen[0] + seen[1] + seen[2]):
        for c in range(3):
            film.data[pixel, options.specular_albedo + c] += seen[c]
    mean = share * roughness * (through[0] + through[1] + through[2]) / np.float32(3.0)
    if options.roughness >= 0 and math.isfinite(mean):
        film.data[pixel, options.roughness] += mean


@kernel
def follow_reflections(scene, unit, work, queue):
    """Write what lanes see of mirrors before they scatter; say which have met what shows nothing behind it, nor in it.

    They count as often as plain sampling would have come there, so that no guide changes the passes.
    """
    options, tables, film = scene.data.options, scene.tables, unit.film
    paths, points, closures, throughput = work.paths, work.points, work.shaded, work.features.mirrored
    follows = options.follows_mirrors != 0
    lanes, lane_count = queue.lanes, queue.count[0]
    for k in range(lane_count):
        lane = lanes[k]
        if paths.alive[lane] == 0 or paths.flags[lane] & (RAY_MIRRORS_DONE | RAY_SUBSURFACE):
            continue
        if paths.depth[lane] > 1:
            paths.flags[lane] |= RAY_MIRRORS_DONE
            continue
        specular, transparent, roughness, share = sum_mirrors(
            closures, tables, lane, real_3(points, lane, POINT_WO), options.looks_up_transmission,
            options.weighs_by_roughness, work.f_cos,
        )
        through = (np.float32(1.0), np.float32(1.0), np.float32(1.0))
        if paths.depth[lane] + paths.transparent_depth[lane] > 0:
            through = load(throughput, lane)
        if paths.depth[lane] == 0:
            plain_share = np.float32(1.0) / paths.unguided[lane]
            _write_mirrors(options, film, paths.pixel[lane], specular, roughness, through, plain_share)
        behind = add(scale(specular, share), transparent)
        # Where reflections are not followed, those of which the motion is asked for are, but do not weigh.
        looked_for = behind if follows or options.specular_motion >= 0 else transparent
        if max(abs(looked_for[0]), abs(looked_for[1]), abs(looked_for[2])) > _LEAST_SEEN:
            store(throughput, lane, multiply(through, behind if follows else transparent))
        else:
            paths.flags[lane] |= RAY_MIRRORS_DONE


@kernel
def write_reflected_motion(scene, unit, work, queue):
    """Add the motion of what is seen in the first reflection to the film, before the radiance cache ends paths there.

    It counts as often as plain sampling would have found it, so that no guide changes the pass.
    """
    data, camera, geometry = scene.data, scene.camera, scene.geometry
    first, paths, points, film = data.options.specular_motion, work.paths, work.points, unit.film
    lanes, lane_count = queue.lanes, queue.count[0]
    for k in range(lane_count):
        lane = lanes[k]
        flags = paths.flags[lane]
        if paths.depth[lane] != 1 or not flags & RAY_REFLECT or flags & (RAY_MIRRORS_DONE | RAY_SUBSURFACE | RAY_ENDS):
            continue
        x, y = reflected_motion(
            data, camera, geometry, points.integer[lane, POINT_INSTANCE], points.integer[lane, POINT_TRIANGLE],
            points.real[lane, POINT_U], points.real[lane, POINT_V], real_3(points, lane, POINT_P),
            load(paths.mis_origin, lane), load(paths.mis_normal, lane),
        )
        # Roulette has been played and not been settled yet.
        share = paths.unguided_survival[lane] / (paths.survival[lane] * paths.unguided[lane])
        if math.isfinite(share * (x + y)):
            film.data[paths.pixel[lane], first] += share * x
            film.data[paths.pixel[lane], first + 1] += share * y
