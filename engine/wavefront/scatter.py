# SPDX-License-Identifier: GPL-3.0-or-later
"""Stage: sample the BSDF and send the path on."""

import numpy as np

from engine.jit import kernel
from engine.kernels.bsdf import HAS_TRANSMISSION, sample_bsdf, summarize
from engine.kernels.rng import SETS_PER_VERTEX
from engine.kernels.surface import offset_origin
from engine.kernels.vector import normalize, store
from engine.state import (
    POINT_NG,
    POINT_NS,
    POINT_P,
    POINT_RADIUS,
    POINT_WO,
    RAY_DIFFUSE,
    RAY_DIFFUSE_ANCESTOR,
    RAY_GLOSSY,
    RAY_MIS_HAD_TRANSMISSION,
    RAY_MIS_SKIP,
    RAY_REFLECT,
    RAY_SINGULAR,
    RAY_TERMINATE_AFTER_TRANSPARENT,
    RAY_TERMINATE_ON_NEXT_SURFACE,
    RAY_TRANSMIT,
    RAY_TRANSPARENT,
    RAY_TRANSPARENT_BACKGROUND,
    RAY_VISIBILITY,
)

#: Everything a scattering clears before it sets its own.
_RESET = ~(
    RAY_VISIBILITY
    | RAY_REFLECT
    | RAY_SINGULAR
    | RAY_TRANSPARENT
    | RAY_MIS_SKIP
    | RAY_MIS_HAD_TRANSMISSION
)
_INFINITE = np.float32(np.inf)


@kernel
def real_3(points, lane, column):
    """Three consecutive floats of a point."""
    return points.real[lane, column], points.real[lane, column + 1], points.real[lane, column + 2]


@kernel
def scatter(options, tables, paths, points, closures, f_cos, lanes, lane_count):
    """Choose the next direction by the BSDF, update throughput, depths and flags.

    Parameters
    ----------
    f_cos : float32 (L, C)
        Scratch for the BSDF's value.
    """
    for k in range(lane_count):
        lane = lanes[k]
        if paths.alive[lane] == 0:
            continue
        wo = real_3(points, lane, POINT_WO)
        ng = real_3(points, lane, POINT_NG)
        pdf, wi, label, roughness, _eta = sample_bsdf(
            closures, tables, lane, wo, ng, paths.random[lane, 0], paths.random[lane, 1], paths.random[lane, 2], f_cos,
            lane,
        )
        if not pdf > 0.0:
            paths.alive[lane] = 0
            continue
        inverse = 1.0 / pdf
        largest = 0.0
        for c in range(len(paths.channels)):
            value = paths.throughput[lane, c] * f_cos[lane, c] * inverse
            paths.throughput[lane, c] = value
            largest = max(largest, abs(value))
        if not largest > 0.0:
            paths.alive[lane] = 0
            continue
        flags = paths.flags[lane]
        p = real_3(points, lane, POINT_P)
        paths.dimension[lane] += SETS_PER_VERTEX
        distance = paths.hit_distance[lane]
        paths.hit_distance[lane] = _INFINITE
        if label & RAY_TRANSPARENT:
            # The ray goes on as the same ray: its kind, MIS density and origin are those of the last scattering.
            paths.transparent_depth[lane] += 1
            flags |= RAY_TRANSPARENT
            if paths.transparent_depth[lane] >= options.max_transparent_depth:
                flags |= RAY_TERMINATE_ON_NEXT_SURFACE
            paths.flags[lane] = flags
            paths.mis_distance[lane] += distance
            paths.radius[lane] += distance * paths.spread[lane]
            direction = (paths.direction[lane, 0], paths.direction[lane, 1], paths.direction[lane, 2])
            store(paths.origin, lane, offset_origin(p, ng, direction, paths.offset[lane]))
            continue

        wi = normalize(wi)
        origin = offset_origin(p, ng, wi, paths.offset[lane])
        store(paths.origin, lane, origin)
        store(paths.direction, lane, wi)
        paths.radius[lane] = points.real[lane, POINT_RADIUS]
        paths.mis_pdf[lane] = pdf
        store(paths.mis_origin, lane, p)
        store(paths.mis_normal, lane, real_3(points, lane, POINT_NS))
        paths.mis_distance[lane] = 0.0
        # A delta lobe's density is infinite: it blurs nothing behind it.
        if not label & RAY_SINGULAR:
            paths.min_pdf[lane] = min(paths.min_pdf[lane], pdf)

        depth = paths.depth[lane] + 1
        paths.depth[lane] = depth
        ends = depth >= options.max_depth
        flags &= _RESET
        if label & RAY_REFLECT:
            flags |= RAY_REFLECT
            flags &= ~RAY_TRANSPARENT_BACKGROUND
            if label & RAY_DIFFUSE:
                paths.diffuse_depth[lane] += 1
                ends |= paths.diffuse_depth[lane] >= options.max_diffuse_depth
            else:
                paths.glossy_depth[lane] += 1
                ends |= paths.glossy_depth[lane] >= options.max_glossy_depth
        else:
            flags |= RAY_TRANSMIT
            flags &= ~RAY_TRANSPARENT_BACKGROUND
            paths.transmission_depth[lane] += 1
            ends |= paths.transmission_depth[lane] >= options.max_transmission_depth
        if label & RAY_DIFFUSE:
            flags |= RAY_DIFFUSE | RAY_DIFFUSE_ANCESTOR
        elif label & RAY_SINGULAR:
            flags |= RAY_GLOSSY | RAY_SINGULAR | RAY_MIS_SKIP
        else:
            flags |= RAY_GLOSSY
        if summarize(closures, lane) & HAS_TRANSMISSION:
            flags |= RAY_MIS_HAD_TRANSMISSION
        if ends:
            flags |= RAY_TERMINATE_AFTER_TRANSPARENT
        paths.flags[lane] = flags
