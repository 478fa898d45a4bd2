# SPDX-License-Identifier: GPL-3.0-or-later
"""Stage: keep photons where they have arrived, and send them on over delta lobes.

References: Veach 1997, section 5.3: what light carries over refracting surfaces and over shading normals, against what
paths from the camera carry.
"""

import math

import numpy as np

from engine.kernels.bsdf import DELTA_LOBES, sample_among
from engine.kernels.bsdf.kinds import SUBSURFACE
from engine.kernels.caustics import LEAST_COSINE, may_gather
from engine.kernels.path import pass_through, real_3, scatter_path
from engine.kernels.rng import SET_BSDF, SETS_PER_VERTEX, sample_4d
from engine.kernels.vector import add, dot, normalize, scale
from engine.runtime.jit import kernel
from engine.state.lanes import (
    POINT_NG,
    POINT_P,
    POINT_WO,
    RAY_ENDS,
    RAY_GLOSSY,
    RAY_REFLECT,
    RAY_SINGULAR,
    RAY_SUBSURFACE,
    RAY_TRANSMIT,
    RAY_TRANSPARENT,
)
from engine.state.photons import (
    PHOTON_DENSITY,
    PHOTON_DEPTH,
    PHOTON_GLOSSY,
    PHOTON_GROUP,
    PHOTON_NG,
    PHOTON_P,
    PHOTON_POWER,
    PHOTON_WI,
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
def _keep(work, lane, row):
    """Write the lane's photon into a row of those that have arrived."""
    paths, points, photons = work.paths, work.points, work.photons
    found = photons.found
    p, wi, ng = real_3(points, lane, POINT_P), real_3(points, lane, POINT_WO), real_3(points, lane, POINT_NG)
    for k in range(3):
        found[row, PHOTON_P + k] = p[k]
        found[row, PHOTON_WI + k] = wi[k]
        found[row, PHOTON_NG + k] = ng[k]
        found[row, PHOTON_POWER + k] = paths.throughput[lane, k]
    found[row, PHOTON_DENSITY] = photons.density[lane]
    found[row, PHOTON_GROUP] = np.float32(photons.group[lane])
    found[row, PHOTON_DEPTH] = np.float32(paths.depth[lane])
    found[row, PHOTON_GLOSSY] = np.float32(paths.glossy_depth[lane])


@kernel
def _adjoint_factor(wo, wi, ng, eta, is_reflected):
    """What makes of a path's factor at a delta lobe a photon's, which arrives along `wo` and leaves along `wi`.

    Light is squeezed as much as radiance is stretched by refraction, which this renderer, as Cycles, leaves out of
    both; and a shading normal bends a beam otherwise than its surface would.
    """
    squeeze = np.float32(1.0)
    if is_reflected:
        n = normalize(add(wo, wi))
    else:
        n = normalize(add(wo, scale(wi, eta)))
        squeeze = np.float32(1.0) / (eta * eta)
    above = abs(dot(wo, n)) * abs(dot(wi, ng))
    below = abs(dot(wi, n)) * abs(dot(wo, ng))
    return squeeze * min(above / max(below, LEAST_COSINE * LEAST_COSINE), _LARGEST_FACTOR)


@kernel
def keep_photons(scene, unit, work, queue):
    """Keep photons at surfaces that gather them, and choose a delta lobe for each to go on by; the others end.

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
            _keep(work, lane, kept)
            kept += 1
        if flags & RAY_ENDS:
            continue
        wo, ng = real_3(points, lane, POINT_WO), real_3(points, lane, POINT_NG)
        u1, u2, u0, u3 = sample_4d(paths.rng[lane], paths.sample[lane], paths.dimension[lane] + SET_BSDF)
        pdf, wi, label, _roughness, eta = sample_among(
            closures, lane, wo, ng, DELTA_LOBES, u0, u1, u2, f_cos, lane
        )
        if not pdf > 0.0 or label & RAY_SUBSURFACE:
            continue
        paths.dimension[lane] += SETS_PER_VERTEX
        is_passed = label & RAY_TRANSPARENT != 0
        if is_passed and depth == 0:
            continue
        factor = np.float32(1.0) / pdf
        if not is_passed:
            if not label & RAY_SINGULAR:
                continue
            if depth == 0:
                # The kind of ray that finds the light there.
                kind = RAY_GLOSSY if label & RAY_REFLECT else RAY_TRANSMIT
                if not work.photons.visibility[lane] & kind:
                    continue
            wi = normalize(wi)
            factor *= _adjoint_factor(wo, wi, ng, eta, label & RAY_REFLECT != 0)
        before, after = np.float32(0.0), np.float32(0.0)
        for c in range(len(paths.channels)):
            before = max(before, abs(paths.throughput[lane, c]))
            after = max(after, abs(paths.throughput[lane, c] * f_cos[lane, c] * factor))
        if not after > 0.0 or not math.isfinite(after):
            continue
        # Photons of like power make smooth pictures: roulette keeps what they had.
        survival = min(after / before, np.float32(1.0))
        if u3 >= survival:
            continue
        factor /= survival
        for c in range(len(paths.channels)):
            paths.throughput[lane, c] *= f_cos[lane, c] * factor
        if is_passed:
            pass_through(options, paths, points, lane)
        else:
            scatter_path(options, scene.lights, paths, points, closures, lane, wi, label, pdf, pdf)
        paths.alive[lane] = 1
    work.counts[PHOTONS] = kept
