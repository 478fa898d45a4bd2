# SPDX-License-Identifier: GPL-3.0-or-later
"""Stages: motion of what mirrors show, for denoisers that look at the frame before. Run only if it was asked for.

As in Cycles: what lies behind the first scattering counts, if that was a reflection at a surface that is a mirror for
more than half, or is transparent in part.
"""

import math

import numpy as np

from engine.kernels.bsdf import add_albedo
from engine.kernels.bsdf.kinds import ALPHA_X, ALPHA_Y, FIRST_MICROFACET, LAST_MICROFACET, TRANSPARENT
from engine.kernels.bsdf.portal import is_portal
from engine.kernels.pass_vectors import reflected_motion
from engine.kernels.path import real_3
from engine.kernels.vector import load, store
from engine.runtime.jit import kernel
from engine.state.lanes import (
    POINT_INSTANCE,
    POINT_P,
    POINT_TRIANGLE,
    POINT_U,
    POINT_V,
    POINT_WO,
    RAY_ENDS,
    RAY_MOTION_DONE,
    RAY_REFLECT,
    RAY_SUBSURFACE,
)

#: From this alpha on a lobe is no mirror at all.
_DULL_ALPHA = np.float32(0.15)
#: From this share of lobes that are no mirrors on, the path shows nothing behind the surface.
_DULL_SHARE = np.float32(0.5)
#: Albedo of mirrors and of what is transparent up to which there is none.
_LEAST_ALBEDO = np.float32(1e-4)


@kernel
def _smooth_step(x):
    """From 0 to 1, level at both."""
    x = min(max(x, np.float32(0.0)), np.float32(1.0))
    return x * x * (np.float32(3.0) - np.float32(2.0) * x)


@kernel
def _dullness(closures, lane, i):
    """How far a lobe is from a mirror, from 0 to 1."""
    if FIRST_MICROFACET <= closures.kind[lane, i] <= LAST_MICROFACET:
        alpha_squared = closures.param[lane, i, ALPHA_X] * closures.param[lane, i, ALPHA_Y]
        return _smooth_step(math.sqrt(max(alpha_squared, np.float32(0.0))) / _DULL_ALPHA)
    return np.float32(1.0)


@kernel
def _goes_on(closures, tables, lane, wo, looks_up, scratch):
    """Whether what is behind a surface, or mirrored in it, counts as well; row `lane` of `scratch` is overwritten."""
    total = dull = bright = passed = np.float32(0.0)
    for i in range(closures.count[lane]):
        store(scratch, lane, (0.0, 0.0, 0.0))
        add_albedo(closures, tables, lane, i, wo, looks_up, scratch, lane)
        albedo = load(scratch, lane)
        if closures.kind[lane, i] == TRANSPARENT or is_portal(closures, lane, i):
            passed = max(passed, abs(albedo[0]), abs(albedo[1]), abs(albedo[2]))
            continue
        mean = (albedo[0] + albedo[1] + albedo[2]) / np.float32(3.0)
        dullness = _dullness(closures, lane, i)
        total += mean
        dull += mean * dullness
        bright += max(albedo[0], albedo[1], albedo[2]) * (np.float32(1.0) - dullness)
    share = np.float32(0.0)
    if total > 0.0:
        share = np.float32(1.0) - _smooth_step(dull / total / _DULL_SHARE)
    return max(passed, bright * share) > _LEAST_ALBEDO


@kernel
def follow_reflections(scene, unit, work, queue):
    """Say which shaded lanes have met what shows nothing behind it, and nothing mirrored."""
    options, tables = scene.data.options, scene.tables
    paths, points, closures = work.paths, work.points, work.shaded
    lanes, lane_count = queue.lanes, queue.count[0]
    for k in range(lane_count):
        lane = lanes[k]
        if paths.alive[lane] == 0 or paths.flags[lane] & (RAY_MOTION_DONE | RAY_SUBSURFACE):
            continue
        wo = real_3(points, lane, POINT_WO)
        if paths.depth[lane] > 1 or not _goes_on(
            closures, tables, lane, wo, options.looks_up_transmission, work.f_cos
        ):
            paths.flags[lane] |= RAY_MOTION_DONE


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
        if paths.depth[lane] != 1 or not flags & RAY_REFLECT or flags & (RAY_MOTION_DONE | RAY_SUBSURFACE | RAY_ENDS):
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
