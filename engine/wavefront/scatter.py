# SPDX-License-Identifier: GPL-3.0-or-later
"""Stage: sample the BSDF and send the path on."""

from engine.guiding.records.vertices import Scattering, log_vertex
from engine.kernels.bsdf import DELTA_LOBES, EVERY_LOBE, sample_among
from engine.kernels.bsdf.dispersion import share_densities
from engine.kernels.bsdf.evaluate import LABEL_LOBE
from engine.kernels.bsdf.kinds import CLOSURE_DISPERSES
from engine.kernels.constants import NAN
from engine.kernels.path import pass_through, real_3, scatter_path
from engine.kernels.prefetch import (
    ask_for_closures,
    ask_for_history,
    ask_for_point,
    ask_for_ray,
    ask_for_throughput,
    lane_ahead,
)
from engine.kernels.rng import SETS_PER_VERTEX
from engine.kernels.vector import normalize
from engine.runtime.jit import kernel
from engine.state.lanes import POINT_NG, POINT_WO, RAY_SINGULAR, RAY_SUBSURFACE, RAY_TRANSPARENT, RGB


@kernel
def scatter(scene, unit, work, queue):
    """Choose the next direction by the BSDF, update throughput, depths and flags.

    Guided lanes draw here whether a delta lobe is taken, and the lobe; if not, they are left to resampling: those with
    one candidate, for which nothing needs to be predicted, in `work.single`, the others in `work.several`. Those that
    go on elsewhere, below the surface or through a portal, are left in `work.walking`.
    """
    options, paths, points, closures = scene.options, work.paths, work.points, work.closures
    guided, samples, log, f_cos = work.guided, work.samples, work.log, work.f_cos
    single, several, walking = work.single.lanes, work.several.lanes, work.walking.lanes
    lanes, lane_count = queue.lanes, queue.count[0]
    single_count = 0
    several_count = 0
    walking_count = 0
    for k in range(lane_count):
        lane = lanes[k]
        ahead = lane_ahead(lanes, k, lane_count)
        ask_for_ray(paths, ahead)
        ask_for_throughput(paths, ahead)
        ask_for_history(paths, ahead)
        ask_for_point(points, ahead)
        ask_for_closures(closures, ahead)
        if paths.alive[lane] == 0:
            continue
        paths.survival[lane] = -1.0
        u0 = paths.random[lane, 0]
        is_guided = guided.rough_share[lane] > 0.0
        if is_guided:
            delta_share = 1.0 - guided.rough_share[lane]
            if u0 >= delta_share:
                if guided.candidate_count[lane] > 1:
                    several[several_count] = lane
                    several_count += 1
                else:
                    single[single_count] = lane
                    single_count += 1
                continue
            u0 = u0 / delta_share
        wo = real_3(points, lane, POINT_WO)
        ng = real_3(points, lane, POINT_NG)
        u1 = paths.random[lane, 1]
        u2 = paths.random[lane, 2]
        choice = DELTA_LOBES if is_guided else EVERY_LOBE
        pdf, wi, label, roughness, eta = sample_among(closures, lane, wo, ng, choice, u0, u1, u2, f_cos, lane)
        if not pdf > 0.0:
            paths.alive[lane] = 0
            continue
        inverse = 1.0 / pdf
        largest = 0.0
        for c in range(len(paths.channels)):
            before = paths.throughput[lane, c]
            value = before * f_cos[lane, c] * inverse
            f_cos[lane, c] = before
            paths.throughput[lane, c] = value
            largest = max(largest, abs(value))
        if not largest > 0.0:
            paths.alive[lane] = 0
            continue
        if len(paths.channels) > RGB and closures.flags[lane] & CLOSURE_DISPERSES != 0:
            share_densities(paths, lane, pdf, f_cos, lane)
        paths.dimension[lane] += SETS_PER_VERTEX
        if label & RAY_SUBSURFACE:
            work.walks.lobe[lane] = label >> LABEL_LOBE
            walking[walking_count] = lane
            walking_count += 1
            continue
        if label & RAY_TRANSPARENT:
            pass_through(options, paths, points, lane)
            continue
        wi = normalize(wi)
        if log.is_recording[lane] != 0:
            if label & RAY_SINGULAR:
                roughness = 0.0
            scattering = Scattering(wi, pdf, roughness, eta, NAN, NAN, NAN)
            log_vertex(log, paths, points, closures, samples, lane, scattering, f_cos)
        scatter_path(options, scene.lights, paths, points, closures, lane, wi, label, pdf, pdf)
    work.single.count[0] = single_count
    work.several.count[0] = several_count
    work.walking.count[0] = walking_count
