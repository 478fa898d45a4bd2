# SPDX-License-Identifier: GPL-3.0-or-later
"""What guided stages share at collisions with media: proposing a direction, and sending a path on along one.

The phase functions take the place of the BSDF: they have no normal, no cosine and no lobe that is delta.
"""

from typing import NamedTuple

from engine.guiding.records.vertices import Scattering, log_collision
from engine.guiding.sampling.guide import eval_guide, eval_wavelengths, predict_guide, sample_guide
from engine.guiding.sampling.scattering import LEAST_UNGUIDED, MOST_UNGUIDED, expected_survival
from engine.kernels.bsdf.dispersion import share_densities
from engine.kernels.bsdf.phase import eval_phases, phase_roughness, sample_phases
from engine.kernels.collision import scatter_throughput
from engine.kernels.constants import ONE_MINUS_EPSILON
from engine.kernels.path import leave_collision, real_3
from engine.kernels.rng import SETS_PER_VERTEX
from engine.runtime.jit import kernel
from engine.state.lanes import POINT_WO, RGB


class PhaseCandidate(NamedTuple):
    """A direction that was proposed at a collision.

    Attributes
    ----------
    wi : tuple of 3 float32, unit
    source_pdf : float32 [sr^-1]
        Density of the mixture, Eq. (7).
    phase_pdf, guide_pdf : float32 [sr^-1]
    """

    wi: tuple[float, float, float]
    source_pdf: float
    phase_pdf: float
    guide_pdf: float


@kernel
def propose_at_collision(work, guide, lane, u0, u1, u2, out, row):
    """A candidate, by the guide with the lane's guiding probability, else by the phase functions.

    Parameters
    ----------
    u0, u1, u2 : float32 in [0, 1)
        Guide or phase functions, and which lobe; direction (2).
    out : float32 (R, C)
        Row `row` receives the value of the phase functions [sr^-1].

    Returns
    -------
    PhaseCandidate
        With a source density of 0 if there is none.
    """
    closures, probability = work.closures, work.guided.probability[lane]
    wo = real_3(work.points, lane, POINT_WO)
    if u0 < probability:
        wi = sample_guide(guide, lane, u0 / probability, u1, u2)
    else:
        u0 = min((u0 - probability) / (1.0 - probability), ONE_MINUS_EPSILON)
        wi = sample_phases(closures, lane, wo, u0, u1, u2)
    phase_pdf = eval_phases(closures, lane, wo, wi, out, row)
    guide_pdf = eval_guide(guide, lane, wi)
    source_pdf = probability * guide_pdf + (1.0 - probability) * phase_pdf
    return PhaseCandidate(wi, source_pdf, phase_pdf, guide_pdf)


@kernel
def send_on_from_collision(scene, unit, guide, work, lane, candidate, weight, benefit):
    """Send a path on along a candidate: throughput, depths, flags, record, and what roulette is to know.

    Light that is met is weighed against the light sample of the collision by the source density, as that sample was by
    `guide_lights`. Samples of whole segments do not know where on them a path collides: against those it is weighed by
    the phase functions' density, whatever drew the direction.

    Parameters
    ----------
    scene, unit, guide, work
        As stages have them. Row `lane` of `work.f_cos` holds the value of the phase functions.
    candidate : PhaseCandidate
    weight : float32 [sr]
        Its contribution weight, 1 / source_pdf if there was no other.
    benefit : float32
        Factor of Eq. (19), NaN = none.
    """
    paths, points, closures, media, log, f_cos = (
        work.paths, work.points, work.closures, work.media, work.log, work.f_cos,
    )  # fmt: skip
    wi, phase_pdf, guide_pdf = candidate.wi, candidate.phase_pdf, candidate.guide_pdf
    if not scatter_throughput(paths, lane, f_cos, weight) > 0.0:
        paths.alive[lane] = 0
        return
    if len(paths.channels) > RGB:
        # The guide's densities by wavelength, in the last third of the row, become those of both in the second.
        count = len(paths.channels)
        if eval_wavelengths(guide, lane, wi, f_cos, lane, 2 * count):
            probability = work.guided.probability[lane]
            for c in range(count):
                density = probability * f_cos[lane, 2 * count + c] + (1.0 - probability) * phase_pdf
                f_cos[lane, count + c] = density
            share_densities(paths, lane, candidate.source_pdf, f_cos, lane)
    work.samples.weight[lane] = 1.0
    if phase_pdf > 0.0:
        unguided = paths.unguided[lane] / (weight * phase_pdf)
        paths.unguided[lane] = min(max(unguided, LEAST_UNGUIDED), MOST_UNGUIDED)
    paths.dimension[lane] += SETS_PER_VERTEX
    total = 0.0
    for c in range(len(paths.channels)):
        total += abs(paths.throughput[lane, c])
    paths.survival[lane] = expected_survival(unit, paths, lane, predict_guide(guide, lane, wi, guide_pdf), total)
    if log.is_recording[lane] != 0:
        scattering = Scattering(wi, 1.0 / weight, phase_roughness(closures, lane), 1.0, benefit, phase_pdf, guide_pdf)
        log_collision(log, paths, points, closures, work.samples, lane, scattering, f_cos)
    mis_pdf = phase_pdf if media.is_lit[lane] != 0 else candidate.source_pdf
    leave_collision(scene.options, scene.lights, paths, points, media, lane, wi, mis_pdf, phase_pdf)
