# SPDX-License-Identifier: GPL-3.0-or-later
"""Stage: what helps a denoiser tell detail from noise. Runs only if it was asked for.

Mirrors and glass look as what is seen in them: where specular lobes have three quarters or more of the weight, the path
goes on, and the first other surface counts, times the albedos of the specular ones. Light that is seen on the way
counts as albedo (`engine.kernels.radiance.add_seen`). All as in Cycles, so that the passes are the same.
"""

import math

from engine.kernels.bsdf import add_albedo, feature_normal
from engine.kernels.bsdf.kinds import ALPHA_X, ALPHA_Y, FIRST_MICROFACET, LAST_MICROFACET, TRANSPARENT
from engine.kernels.bsdf.portal import is_portal
from engine.kernels.path import real_3
from engine.kernels.vector import add, load, scale, store
from engine.runtime.jit import kernel
from engine.state.film import DENOISING_ALBEDO, DENOISING_DEPTH, DENOISING_NORMAL
from engine.state.lanes import CLOSURE_SAMPLE_WEIGHT, FEATURES_DONE, POINT_WO, RAY_SUBSURFACE

#: Product of the alphas up to which a lobe is specular.
_SPECULAR_ALPHA_SQUARED = 0.075 * 0.075


@kernel
def _is_specular(closures, lane, i):
    kind = closures.kind[lane, i]
    if FIRST_MICROFACET <= kind <= LAST_MICROFACET:
        return closures.param[lane, i, ALPHA_X] * closures.param[lane, i, ALPHA_Y] <= _SPECULAR_ALPHA_SQUARED
    return kind == TRANSPARENT or is_portal(closures, lane, i)


@kernel
def _albedo(closures, tables, lane, wo, of_specular, looks_up, out):
    """Albedo of a lane's specular lobes together, or of the others; row `lane` of `out` is scratch."""
    store(out, lane, (0.0, 0.0, 0.0))
    for i in range(closures.count[lane]):
        if _is_specular(closures, lane, i) == of_specular:
            add_albedo(closures, tables, lane, i, wo, looks_up, out, lane)
    return load(out, lane)


@kernel
def write_denoising(scene, unit, work, queue):
    """Add normal, albedo and depth of lanes that have met specular surfaces only; let those that still do go on.

    Normals are in the camera's space, z forwards. Depths are lengths of paths, of each surface as bright as it is seen.
    """
    camera, tables = scene.camera, scene.tables
    paths, points, closures, scratch = work.paths, work.points, work.shaded, work.f_cos
    throughput, film = work.features.throughput, unit.film.denoising
    looks_up = scene.data.options.looks_up_transmission
    lanes, lane_count = queue.lanes, queue.count[0]
    for k in range(lane_count):
        lane = lanes[k]
        if paths.alive[lane] == 0 or throughput[lane, 0] == FEATURES_DONE or paths.flags[lane] & RAY_SUBSURFACE:
            continue
        pixel = paths.pixel[lane]
        through = load(throughput, lane)
        mean = (through[0] + through[1] + through[2]) / 3.0
        film[pixel, DENOISING_DEPTH] += mean * paths.hit_distance[lane]
        total = 0.0
        rough = 0.0
        normal = (0.0, 0.0, 0.0)
        wo = real_3(points, lane, POINT_WO)
        for i in range(closures.count[lane]):
            weight = closures.param[lane, i, CLOSURE_SAMPLE_WEIGHT]
            total += weight
            if not _is_specular(closures, lane, i):
                rough += weight
            normal = add(normal, scale(feature_normal(closures, lane, i, wo), weight))
        is_specular = total > 0.0 and rough * 4.0 <= total
        albedo = _albedo(closures, tables, lane, wo, is_specular, looks_up, scratch)
        seen = (through[0] * albedo[0], through[1] * albedo[1], through[2] * albedo[2])
        if is_specular:
            store(throughput, lane, seen)
            continue
        throughput[lane, 0] = FEATURES_DONE
        if total > 0.0:
            normal = scale(normal, 1.0 / total)
        if not math.isfinite(seen[0] + seen[1] + seen[2] + normal[0] + normal[1] + normal[2]):
            continue
        for c in range(3):
            film[pixel, DENOISING_ALBEDO + c] += seen[c]
            along = camera[c] * normal[0] + camera[4 + c] * normal[1] + camera[8 + c] * normal[2]
            film[pixel, DENOISING_NORMAL + c] += along if c < 2 else -along
