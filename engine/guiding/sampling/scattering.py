# SPDX-License-Identifier: GPL-3.0-or-later
"""What guided stages share: proposing a direction, and sending a path on along one.

References: Vorba and Krivanek 2016, "Adjoint-Driven Russian Roulette and Splitting in Light Transport Simulation": what
is learned of the radiance says what a path may still bring. Here only the least probability of going on comes of it,
without splitting.
"""

import math

import numpy as np

from engine.guiding.records.vertices import distance_scale, log_vertex
from engine.guiding.sampling.guide import eval_guide, eval_wavelengths, predict_guide, sample_guide
from engine.kernels.bsdf import ROUGH_LOBES, eval_guided, mean_roughness, sample_among
from engine.kernels.bsdf.dispersion import share_densities
from engine.kernels.bsdf.kinds import CLOSURE_DISPERSES
from engine.kernels.path import real_3, scatter_path
from engine.kernels.rng import SETS_PER_VERTEX
from engine.kernels.vector import normalize
from engine.runtime.jit import kernel
from engine.state.lanes import POINT_NG, POINT_NS, POINT_P, POINT_WO, RGB

#: Bounds on the factor between BSDF sampling and what was done instead, per path: roulette must not run away.
_LEAST_UNGUIDED = 1e-6
_MOST_UNGUIDED = 1e6
#: Roulette lets a path go on for sure where it is expected to bring a quarter of its pixel's value, less often where it
#: brings less. What is expected is uncertain, and ending paths that mattered costs more than tracing some that do not
#: (docs/decisions/roulette-and-light-sampling.md).
_SURE_SHARE = np.float32(4.0)
_LEAST_SURVIVAL = np.float32(0.2)


@kernel
def propose(paths, points, closures, guided, guide, lane, u0, u1, u2, u3, f_cos, row):
    """A candidate, by the guide with the lane's guiding probability, else by the BSDF's rough lobes.

    Parameters
    ----------
    u0, u1, u2, u3 : float32 in [0, 1)
        Guide or BSDF, and which lobe; direction; the BSDF's lobe that is credited with the guide's direction.
    f_cos : float32 (>= row + 1, `state.value_width`)
        The BSDF's value times the cosine goes to its row `row`.

    Returns
    -------
    wi : tuple of 3 float32, unit
    source_pdf : float32 [sr^-1]
        Density of the mixture, Eq. (7).
    bsdf_pdf, guide_pdf : float32 [sr^-1]
    label : int; roughness, eta : float32
        As `sample_bsdf` returns them.
    is_valid : bool
        False: there is no such candidate, it counts as one of value 0.
    """
    wo = real_3(points, lane, POINT_WO)
    ng = real_3(points, lane, POINT_NG)
    probability = guided.probability[lane]
    if u0 < probability:
        wi = sample_guide(guide, lane, u0 / probability, u1, u2)
        bsdf_pdf, label, roughness, eta = eval_guided(closures, lane, wo, wi, ng, u3, f_cos, row)
    else:
        u0 = (u0 - probability) / (1.0 - probability)
        bsdf_pdf, wi, label, roughness, eta = sample_among(
            closures, lane, wo, ng, ROUGH_LOBES, u0, u1, u2, f_cos, row
        )
        wi = normalize(wi)
        if not bsdf_pdf > 0.0:
            label = 0
    guide_pdf = eval_guide(guide, lane, wi)
    source_pdf = probability * guided.rough_share[lane] * guide_pdf + (1.0 - probability) * bsdf_pdf
    largest = 0.0
    for c in range(len(paths.channels)):
        largest = max(largest, f_cos[row, c])
    # Written so that NaN fails.
    is_valid = label != 0 and largest > 0.0 and source_pdf > 0.0
    return wi, source_pdf, bsdf_pdf, guide_pdf, label, roughness, eta, is_valid


@kernel
def send_on(
    options, paths, points, closures, guided, guide, samples, log, pixel_weight, lane, wi, weight, source_pdf, bsdf_pdf,
    guide_pdf, label, roughness, eta, benefit, f_cos, row, before,
):  # fmt: skip
    """Send a path on along a candidate: throughput, depths, flags, record, and what roulette is to know.

    Parameters
    ----------
    guided : GuidedLanes
    guide : see `engine.guiding.sampling.guide`
    samples : LightSamples
    log : VertexLog
    pixel_weight : float32 (P,)
        Of the unit's pixels, see `engine.ris.orca.pixel_weights`.
    lane : int
    wi, source_pdf, bsdf_pdf, guide_pdf, label, roughness, eta
        The candidate, as `propose` returns it.
    weight : float32 [sr]
        Contribution weight of the candidate, 1 / source_pdf if there was no other.
    benefit : float32
        Factor of Eq. (19), NaN = none.
    f_cos : float32 (>= row + 1, `state.value_width`)
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
    if len(paths.channels) > RGB:
        # The two parts by wavelength, as far as they differ: the BSDF's in the second third of the row, the guide's in
        # the last.
        count = len(paths.channels)
        disperses = closures.flags[lane] & CLOSURE_DISPERSES != 0
        is_guided_apart = eval_wavelengths(guide, lane, wi, f_cos, row, 2 * count)
        if disperses or is_guided_apart:
            probability = guided.probability[lane]
            for c in range(count):
                guide_density = f_cos[row, 2 * count + c] if is_guided_apart else guide_pdf
                bsdf_density = f_cos[row, count + c] if disperses else bsdf_pdf
                density = probability * guided.rough_share[lane] * guide_density + (1.0 - probability) * bsdf_density
                f_cos[row, count + c] = density
            share_densities(paths, lane, source_pdf, f_cos, row)
    if bsdf_pdf > 0.0:
        unguided = paths.unguided[lane] / (weight * bsdf_pdf)
        paths.unguided[lane] = min(max(unguided, _LEAST_UNGUIDED), _MOST_UNGUIDED)
    paths.dimension[lane] += SETS_PER_VERTEX
    # What the path is expected to bring to its pixel, over the pixel's value.
    expected = predict_guide(guide, lane, wi, guide_pdf) * math.sqrt(pixel_weight[paths.pixel[lane]])
    expected *= total / len(paths.channels)
    paths.survival[lane] = min(max(_SURE_SHARE * expected, _LEAST_SURVIVAL), 1.0)
    if log.is_recording[lane] != 0:
        wo = real_3(points, lane, POINT_WO)
        ns = real_3(points, lane, POINT_NS)
        log_vertex(
            log, paths, lane, real_3(points, lane, POINT_P), wo, wi, ns, 1.0 / weight, roughness,
            mean_roughness(closures, lane), distance_scale(ns, wo, wi, eta),
            paths.mis_distance[lane] + paths.hit_distance[lane], benefit, bsdf_pdf,
            guided.rough_share[lane] * guide_pdf, samples.weight[lane], before,
        )
    scatter_path(options, paths, points, closures, lane, wi, label, source_pdf, bsdf_pdf)
