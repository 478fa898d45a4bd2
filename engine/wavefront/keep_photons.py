# SPDX-License-Identifier: GPL-3.0-or-later
"""Stage: keep photons where they have arrived, and send them on over sharp lobes.

References: Veach 1997, section 5.3: what light carries over refracting surfaces and over shading normals, against what
paths from the camera carry.
"""

import math

import numpy as np

from engine.kernels.bsdf import DELTA_LOBES, sample_among
from engine.kernels.bsdf.closures import read3
from engine.kernels.bsdf.dispersion import share_densities
from engine.kernels.bsdf.evaluate import EVERY_LOBE
from engine.kernels.bsdf.kinds import ALPHA_X, ALPHA_Y, CLOSURE_DISPERSES, SUBSURFACE, TRANSPARENT
from engine.kernels.caustics import LEAST_COSINE, UNMET, may_gather, sends_photons_on, share_of_scattering
from engine.kernels.path import pass_through, real_3, scatter_path
from engine.kernels.photon_motion import resting_place
from engine.kernels.rng import SET_BSDF, SETS_PER_VERTEX, sample_4d
from engine.kernels.vector import add, dot, normalize, scale
from engine.runtime.jit import kernel
from engine.state.lanes import (
    CLOSURE_N,
    POINT_NG,
    POINT_WO,
    RAY_ENDS,
    RAY_GLOSSY,
    RAY_REFLECT,
    RAY_SINGULAR,
    RAY_SUBSURFACE,
    RAY_TRANSMIT,
    RAY_TRANSPARENT,
    RGB,
)
from engine.state.photons import (
    BOUNCE_LIMIT,
    PHOTON_BOUNCES,
    PHOTON_DENSITY,
    PHOTON_GROUP,
    PHOTON_HERO,
    PHOTON_MOVES,
    PHOTON_NG,
    PHOTON_P,
    PHOTON_POWER,
    PHOTON_POWERS,
    PHOTON_START,
    PHOTON_TIME,
    PHOTON_WI,
    PHOTON_WIDTH,
)
from engine.wavefront.columns import PHOTONS

#: What the shading normals of one surface may make of a photon's power.
_LARGEST_FACTOR = np.float32(10.0)


@kernel
def _is_kept(scene, closures, lane, instance):
    """Whether photons are gathered here, or where light comes out that goes in below the surface."""
    for i in range(closures.count[lane]):
        if closures.kind[lane, i] == SUBSURFACE:
            return True
    return may_gather(scene, closures, lane, instance)


@kernel
def _keep(scene, work, lane, row):
    """Write the lane's photon into a row of those that have arrived."""
    paths, points, photons = work.paths, work.points, work.photons
    found = photons.found
    wi = real_3(points, lane, POINT_WO)
    p, ng, mover, _growth = resting_place(scene, paths, points, lane)
    if found.shape[1] > PHOTON_WIDTH:
        found[row, PHOTON_TIME], found[row, PHOTON_MOVES] = paths.time[lane], mover
    for k in range(3):
        found[row, PHOTON_P + k] = p[k]
        found[row, PHOTON_WI + k] = wi[k]
        found[row, PHOTON_NG + k] = ng[k]
        found[row, PHOTON_POWER + k] = paths.throughput[lane, k]
    if len(paths.channels) > RGB:
        found[row, PHOTON_HERO], mean = paths.hero[lane], np.float32(0.0)
        for c in range(len(paths.channels)):
            found[row, PHOTON_POWERS + c] = paths.throughput[lane, c]
            mean += paths.throughput[lane, c] / np.float32(len(paths.channels))
        for k in range(3):
            found[row, PHOTON_POWER + k] = mean
    found[row, PHOTON_DENSITY] = photons.density[lane]
    found[row, PHOTON_GROUP] = np.float32(photons.group[lane])
    passed = paths.depth[lane] - paths.glossy_depth[lane]
    found[row, PHOTON_BOUNCES] = np.float32(paths.glossy_depth[lane] + BOUNCE_LIMIT * passed)
    found[row, PHOTON_START] = np.float32(photons.start[lane])


@kernel
def _facet_normal(wo, wi, eta):
    """Normal of the facet that sends `wo` to `wi`; `eta` is 1 where it reflects."""
    return normalize(add(wo, scale(wi, eta)))


@kernel
def _first_lobe(closures, lane):
    """Which lobe stands for all of a surface that sends photons on: the first of facets."""
    for i in range(closures.count[lane] - 1):
        if closures.kind[lane, i] < TRANSPARENT:
            return i
    return np.int64(closures.count[lane]) - 1


@kernel
def _adjoint_factor(n, wo, wi, ng, eta):
    """What makes of a path's factor at a sharp lobe about `n` a photon's, which arrives along `wo` and leaves along
    `wi`.

    Light is squeezed as much as radiance is stretched by refraction, which this renderer, as Cycles, leaves out of
    both; and a shading normal bends a beam otherwise than its surface would.
    """
    above = abs(dot(wo, n)) * abs(dot(wi, ng))
    below = abs(dot(wi, n)) * abs(dot(wo, ng))
    return min(above / max(below, LEAST_COSINE * LEAST_COSINE), _LARGEST_FACTOR) / (eta * eta)


@kernel
def _inverse_shadowing(cosine, alpha_squared):
    """One over the share of facets that a direction sees, GGX (Heitz 2014, Eqs. 43 and 72)."""
    squared = max(cosine * cosine, LEAST_COSINE * LEAST_COSINE)
    return np.float32(0.5) + np.float32(0.5) * math.sqrt(
        np.float32(1.0) + alpha_squared * max(np.float32(1.0) - squared, np.float32(0.0)) / squared
    )


@kernel
def _backward_pdf(n, alpha_squared, wo, wi, eta, pdf):
    """Density with which a path that comes along `wi` would be sent to `wo`, if the other way it is `pdf` [sr^-1].

    Densities are of facets that are seen, over their Jacobian (Walter et al. 2007, Eqs. 14 and 17; Heitz 2014).
    """
    cosine_o, cosine_i = abs(dot(wo, n)), max(abs(dot(wi, n)), LEAST_COSINE)
    seen = _inverse_shadowing(cosine_o, alpha_squared) / _inverse_shadowing(cosine_i, alpha_squared)
    return pdf * seen * cosine_o / (cosine_i * eta * eta)


@kernel
def keep_photons(scene, unit, work, queue):
    """Keep photons at surfaces that gather them, and choose a sharp lobe for each to go on by; the others end.

    A caster that a photon has begun at keeps none: light samples find that.

    Parameters
    ----------
    queue : LaneQueue
        `work.surface`, shaded.
    """
    options, paths, points, closures, f_cos = scene.options, work.paths, work.points, work.closures, work.f_cos
    most, kept = work.photons.found.shape[0], work.counts[PHOTONS]
    lanes, lane_count = queue.lanes, queue.count[0]
    for k in range(lane_count):
        lane = lanes[k]
        # It ends unless all goes well.
        paths.alive[lane] = 0
        flags, depth = paths.flags[lane], paths.depth[lane]
        instance = np.int64(paths.hit_instance[lane])
        if depth > 0 and kept < most and _is_kept(scene, closures, lane, instance):
            _keep(scene, work, lane, kept)
            kept += 1
        if flags & RAY_ENDS:
            continue
        wo, ng = real_3(points, lane, POINT_WO), real_3(points, lane, POINT_NG)
        u1, u2, u0, u3 = sample_4d(paths.rng[lane], paths.sample[lane], paths.dimension[lane] + SET_BSDF)
        choice = EVERY_LOBE if sends_photons_on(closures, lane) else DELTA_LOBES
        pdf, wi, label, _roughness, eta = sample_among(closures, lane, wo, ng, choice, u0, u1, u2, f_cos, lane)
        if not pdf > 0.0 or label & RAY_SUBSURFACE:
            continue
        paths.dimension[lane] += SETS_PER_VERTEX
        is_passed = label & RAY_TRANSPARENT != 0
        if is_passed and depth == 0:
            continue
        factor = np.float32(1.0) / pdf
        if not is_passed:
            if depth == 0:
                # The kind of ray that finds the light there.
                kind = RAY_GLOSSY if label & RAY_REFLECT else RAY_TRANSMIT
                if not work.photons.visibility[lane] & kind:
                    continue
            wi = normalize(wi)
            if label & RAY_SINGULAR:
                n = _facet_normal(wo, wi, eta)
            else:
                i = _first_lobe(closures, lane)
                n = read3(closures.param, lane, i, CLOSURE_N)
                if depth == 0:
                    if work.photons.density[lane] >= UNMET:
                        # Light samples find it.
                        continue
                    alpha_squared = closures.param[lane, i, ALPHA_X] * closures.param[lane, i, ALPHA_Y]
                    backward = _backward_pdf(n, alpha_squared, wo, wi, eta, pdf)
                    work.photons.density[lane] *= share_of_scattering(backward, work.samples.pdf[lane])
            factor *= _adjoint_factor(n, wo, wi, ng, eta)
        before, after = np.float32(0.0), np.float32(0.0)
        for c in range(len(paths.channels)):
            before = max(before, abs(paths.throughput[lane, c]))
            after = max(after, abs(paths.throughput[lane, c] * f_cos[lane, c] * factor))
        if not after > 0.0 or not math.isfinite(after):
            continue
        # Photons of like power make smooth pictures: roulette keeps what they had, but for what refraction takes and
        # gives back where light comes out again.
        survival = min(after * eta * eta / before, np.float32(1.0))
        if u3 >= survival:
            continue
        factor /= survival
        for c in range(len(paths.channels)):
            paths.throughput[lane, c] *= f_cos[lane, c] * factor
        if len(paths.channels) > RGB:
            if closures.flags[lane] & CLOSURE_DISPERSES:
                share_densities(paths, lane, pdf, f_cos, lane)
        if is_passed:
            pass_through(options, paths, points, lane)
        else:
            scatter_path(options, scene.lights, paths, points, closures, lane, wi, label, pdf, pdf)
        paths.alive[lane] = 1
    work.counts[PHOTONS] = kept
