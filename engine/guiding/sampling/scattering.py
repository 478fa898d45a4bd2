# SPDX-License-Identifier: GPL-3.0-or-later
"""What guided stages share: proposing a direction, and sending a path on along one.

References: Vorba and Krivanek 2016, "Adjoint-Driven Russian Roulette and Splitting in Light Transport Simulation": what
is learned of the radiance says what a path may still bring. Here only the least probability of going on comes of it,
without splitting.
"""

import math
from typing import NamedTuple

import numpy as np

from engine.guiding.records.vertices import Scattering, log_vertex
from engine.guiding.sampling.guide import eval_guide, eval_wavelengths, predict_guide, sample_guide
from engine.kernels.bsdf import ROUGH_LOBES, eval_guided, sample_among
from engine.kernels.bsdf.dispersion import share_densities
from engine.kernels.bsdf.kinds import CLOSURE_DISPERSES
from engine.kernels.path import real_3, scatter_path
from engine.kernels.rng import SETS_PER_VERTEX
from engine.kernels.vector import normalize
from engine.runtime.jit import kernel
from engine.state.lanes import POINT_NG, POINT_WO, RGB

#: Bounds on the factor between plain sampling and what was done instead, per path, so that it stays a number.
LEAST_UNGUIDED = np.float32(1e-12)
MOST_UNGUIDED = np.float32(1e12)
#: Roulette lets a path go on for sure where it is expected to bring a quarter of its pixel's value, less often where it
#: brings less. What is expected is uncertain, and ending paths that mattered costs more than tracing some that do not
#: (docs/decisions/roulette-and-light-sampling.md).
_SURE_SHARE = np.float32(4.0)
_LEAST_SURVIVAL = np.float32(0.2)


class Candidate(NamedTuple):
    """A direction that was proposed.

    Attributes
    ----------
    wi : tuple of 3 float32, unit
    source_pdf : float32 [sr^-1]
        Density of the mixture, Eq. (7).
    bsdf_pdf, guide_pdf : float32 [sr^-1]
    label : int; roughness, eta : float32
        As `sample_bsdf` returns them.
    row : int
        Of `Candidates.f_cos`: the BSDF's value times the cosine.
    """

    wi: tuple[float, float, float]
    source_pdf: float
    bsdf_pdf: float
    guide_pdf: float
    label: int
    roughness: float
    eta: float
    row: int


@kernel
def expected_survival(unit, paths, lane, radiance, total):
    """Probability with which roulette is to let a path go on, by what it is expected to bring to its pixel.

    Parameters
    ----------
    radiance : float32
        That is expected to arrive, mean over channels.
    total : float32
        The path's throughput, sum over channels.
    """
    # Over the pixel's value.
    expected = radiance * math.sqrt(unit.pixel_weight[paths.pixel[lane]])
    expected *= total / len(paths.channels)
    return min(max(_SURE_SHARE * expected, _LEAST_SURVIVAL), 1.0)


@kernel
def propose(work, guide, lane, u, row):
    """A candidate, by the guide with the lane's guiding probability, else by the BSDF's rough lobes.

    Parameters
    ----------
    work, guide
        As stages have them.
    u : tuple of 4 float32 in [0, 1)
        Guide or BSDF, and which lobe; direction (2); the BSDF's lobe that is credited with the guide's direction.
    row : int
        Of `work.candidates.f_cos`, which receives the BSDF's value times the cosine.

    Returns
    -------
    Candidate
    is_valid : bool
        False: there is no such candidate, it counts as one of value 0.
    """
    paths, points, closures, guided = work.paths, work.points, work.closures, work.guided
    f_cos = work.candidates.f_cos
    u0, u1, u2, u3 = u
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
    return Candidate(wi, source_pdf, bsdf_pdf, guide_pdf, label, roughness, eta, row), is_valid


@kernel
def send_on(scene, unit, guide, work, lane, candidate, weight, benefit):
    """Send a path on along a candidate: throughput, depths, flags, record, and what roulette is to know.

    Row `lane` of `work.f_cos` is scratch.

    Parameters
    ----------
    scene, unit, guide, work
        As stages have them.
    candidate : Candidate
    weight : float32 [sr]
        Its contribution weight, 1 / source_pdf if there was no other.
    benefit : float32
        Factor of Eq. (19), NaN = none.
    """
    paths, points, closures, guided, log = work.paths, work.points, work.closures, work.guided, work.log
    f_cos, before = work.candidates.f_cos, work.f_cos
    wi, row = candidate.wi, candidate.row
    source_pdf, bsdf_pdf, guide_pdf = candidate.source_pdf, candidate.bsdf_pdf, candidate.guide_pdf
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
        paths.unguided[lane] = min(max(unguided, LEAST_UNGUIDED), MOST_UNGUIDED)
    paths.dimension[lane] += SETS_PER_VERTEX
    paths.survival[lane] = expected_survival(unit, paths, lane, predict_guide(guide, lane, wi, guide_pdf), total)
    if log.is_recording[lane] != 0:
        rough_guide_pdf = guided.rough_share[lane] * guide_pdf
        scattering = Scattering(
            wi, 1.0 / weight, candidate.roughness, candidate.eta, benefit, bsdf_pdf, rough_guide_pdf
        )
        log_vertex(log, paths, points, closures, work.samples, lane, scattering, before)
    scatter_path(
        scene.options, scene.lights, paths, points, closures, lane, wi, candidate.label, source_pdf, bsdf_pdf
    )
