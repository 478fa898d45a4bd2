# SPDX-License-Identifier: GPL-3.0-or-later
"""Stages: pick one of each vertex's candidates and send the path on; or draw its only one and do the same.

References: Vorba and Krivanek 2016, "Adjoint-Driven Russian Roulette and Splitting in Light Transport Simulation": what
is learned of the radiance says what a path may still bring. Here only the least probability of going on comes of it,
without splitting.
"""

import math

import numpy as np

from engine.guiding.vertices import distance_scale, log_vertex
from engine.guiding.vmm.field import GUIDE_LINES
from engine.guiding.vmm.query import predict_vmm
from engine.jit import kernel
from engine.kernels.constants import NAN
from engine.kernels.path import real_3, scatter_path
from engine.kernels.prefetch import (
    ask_for_closures,
    ask_for_history,
    ask_for_point,
    ask_for_ray,
    ask_for_throughput,
    lane_ahead,
    prefetch_lines,
)
from engine.kernels.rng import SETS_PER_VERTEX
from engine.kernels.vector import load
from engine.ris.resample import product_target, resample
from engine.state import POINT_NS, POINT_P, POINT_WO
from engine.wavefront.draw_candidates import propose

#: Bounds on the factor between BSDF sampling and what was done instead, per path: roulette must not run away.
_LEAST_UNGUIDED = 1e-6
_MOST_UNGUIDED = 1e6
#: Roulette lets a path go on for sure where it is expected to bring a quarter of its pixel's value, less often where it
#: brings less. What is expected is uncertain, and ending paths that mattered costs more than tracing some that do not
#: (docs/experiments.md).
_SURE_SHARE = np.float32(4.0)
_LEAST_SURVIVAL = np.float32(0.2)


@kernel
def send_on(
    options, paths, points, closures, guided, guide, samples, log, pixel_weight, lane, wi, weight, source_pdf, bsdf_pdf,
    guide_pdf, label, roughness, eta, benefit, f_cos, row, before,
):  # fmt: skip
    """Send a path on along a candidate: throughput, depths, flags, record, and what roulette is to know.

    Parameters
    ----------
    guided : GuidedLanes
    guide : GuideLobes
    samples : LightSamples
    log : VertexLog
    pixel_weight : float32 (P,)
        Of the unit's pixels, see `engine.ris.orca.pixel_weights`.
    lane : int
    wi, source_pdf, bsdf_pdf, guide_pdf, label, roughness, eta
        The candidate, as `draw_candidates.propose` returns it.
    weight : float32 [sr]
        Contribution weight of the candidate, 1 / source_pdf if there was no other.
    benefit : float32
        Factor of Eq. (19), NaN = none.
    f_cos : float32 (>= row + 1, C)
        The BSDF's value times the cosine in row `row`.
    before : float32 (L, C)
        Scratch.
    """
    largest = 0.0
    total = 0.0
    for c in range(len(paths.channels)):
        throughput = paths.throughput[lane, c]
        before[lane, c] = throughput
        throughput *= f_cos[row, c] * weight
        paths.throughput[lane, c] = throughput
        total += abs(throughput)
        largest = max(largest, abs(throughput))
    if not largest > 0.0:
        paths.alive[lane] = 0
        return
    if bsdf_pdf > 0.0:
        unguided = paths.unguided[lane] / (weight * bsdf_pdf)
        paths.unguided[lane] = min(max(unguided, _LEAST_UNGUIDED), _MOST_UNGUIDED)
    paths.dimension[lane] += SETS_PER_VERTEX
    # What the path is expected to bring to its pixel, over the pixel's value.
    expected = predict_vmm(guide, lane, wi, guide_pdf) * math.sqrt(pixel_weight[paths.pixel[lane]])
    expected *= total / len(paths.channels)
    paths.survival[lane] = min(max(_SURE_SHARE * expected, _LEAST_SURVIVAL), 1.0)
    if log.is_recording[lane] != 0:
        wo = real_3(points, lane, POINT_WO)
        ns = real_3(points, lane, POINT_NS)
        log_vertex(
            log, paths, lane, real_3(points, lane, POINT_P), wi, ns, 1.0 / weight, roughness,
            distance_scale(ns, wo, wi, eta), paths.mis_distance[lane] + paths.hit_distance[lane], benefit, bsdf_pdf,
            guided.rough_share[lane] * guide_pdf, samples.weight[lane], before,
        )
    scatter_path(options, paths, points, closures, lane, wi, label, source_pdf, bsdf_pdf)


@kernel
def guide_resample(
    guiding, options, paths, points, closures, guided, guide, samples, log, pixel_weight, candidates, vertex_count,
    row_count, before,
):
    """Resample (see `engine.ris.resample`) and send the paths on.

    Parameters
    ----------
    guiding : GuidingOptions
    candidates : Candidates
        With `radiance` predicted.
    pixel_weight, before : see `send_on`
    """
    for vertex in range(vertex_count):
        lane = candidates.lane[vertex]
        ahead = lane_ahead(candidates.lane, vertex, vertex_count)
        ask_for_ray(paths, ahead)
        ask_for_throughput(paths, ahead)
        ask_for_history(paths, ahead)
        ask_for_point(points, ahead)
        first = candidates.first[vertex]
        last = candidates.first[vertex + 1] if vertex + 1 < vertex_count else row_count
        count = last - first
        for row in range(first, last):
            candidates.target[row] = product_target(
                paths.throughput, lane, candidates.f_cos, candidates.radiance, row, paths.channels,
                guiding.use_scalar_target,
            )
        row, weight = resample(
            candidates.target, candidates.source_pdf, candidates.is_valid, first, count, guiding.defensive_alpha,
            paths.random[lane, 1],
        )
        if row < 0:
            paths.alive[lane] = 0
            continue
        source_pdf = candidates.source_pdf[row]
        # Eq. (19), but for the squared radiance that the path has yet to find.
        benefit = count / (count - 1.0) * (1.0 / (source_pdf * weight) - 1.0)
        send_on(
            options, paths, points, closures, guided, guide, samples, log, pixel_weight, lane,
            load(candidates.direction, row), weight, source_pdf, candidates.bsdf_pdf[row], candidates.guide_pdf[row],
            candidates.label[row], candidates.roughness[row], candidates.eta[row], benefit, candidates.f_cos, row,
            before,
        )


@kernel
def sample_source(
    options, paths, points, closures, guided, guide, samples, log, pixel_weight, candidates, lanes, lane_count, before
):
    """Draw the only candidate of each lane and send the path on: nothing needs to be predicted or kept.

    Parameters
    ----------
    candidates : Candidates
        Scratch.
    lanes : int32 (>= lane_count,)
    pixel_weight, before : see `send_on`
    """
    for k in range(lane_count):
        lane = lanes[k]
        ahead = lane_ahead(lanes, k, lane_count)
        ask_for_ray(paths, ahead)
        ask_for_throughput(paths, ahead)
        ask_for_history(paths, ahead)
        ask_for_point(points, ahead)
        ask_for_closures(closures, ahead)
        prefetch_lines(guide.lobes, ahead, GUIDE_LINES)
        wi, source_pdf, bsdf_pdf, guide_pdf, label, roughness, eta, is_valid = propose(
            paths, points, closures, guided, guide, lane, 0, candidates.f_cos, 0
        )
        if not is_valid:
            paths.alive[lane] = 0
            continue
        send_on(
            options, paths, points, closures, guided, guide, samples, log, pixel_weight, lane, wi, 1.0 / source_pdf,
            source_pdf, bsdf_pdf, guide_pdf, label, roughness, eta, NAN, candidates.f_cos, 0, before,
        )
