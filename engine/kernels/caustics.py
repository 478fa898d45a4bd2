# SPDX-License-Identifier: GPL-3.0-or-later
"""Light that both paths and photons find: what each counts, and who may.

A photon begins at a place on a caster, in the direction of a light sample there, and goes on by delta lobes alone. A
path finds the same light where it leaves a surface that gathers photons, meets delta lobes alone, and then the lamp:
RAY_GATHERED says that the last surface which was not one of delta lobes gathers photons, RAY_CAUSTIC that the last
delta lobe behind it was a caster's. Both densities are of the same pair of a place on the lamp and a direction, so that
the chain's own focusing cancels.

References: Georgiev et al. 2012, "Light Transport Simulation with Vertex Connection and Merging", Eqs. (5) and (7):
the density of merging is that of a photon within the disc; Veach 1997, Eq. (9.8): the balance heuristic.
"""

import numpy as np

from engine.kernels.bsdf import summarize
from engine.kernels.bsdf.kinds import ALPHA_X, ALPHA_Y, FIRST_HAIR, HAS_EVAL, LAST_DIFFUSE, LAST_MICROFACET
from engine.kernels.lights import Receiver, tree_of_ray
from engine.kernels.vector import dot, load, negate
from engine.runtime.jit import kernel
from engine.state.photons import MAP_EXPECTED, MAY_GATHER

#: Surfaces gather photons if a lobe of theirs is at least this rough, as a product of alphas. What is smoother shows
#: single photons.
_LEAST_ROUGH = np.float32(0.02**2)
#: Bound on cosines by which is divided.
LEAST_COSINE = np.float32(1e-4)


@kernel
def may_gather(scene, closures, lane, instance):
    """Whether a surface is one that gathers photons: it stands still, and has a lobe that is rough."""
    if not scene.casters.instances[instance] & MAY_GATHER:
        return False
    if not summarize(closures, lane) & HAS_EVAL:
        return False
    for i in range(closures.count[lane]):
        kind = closures.kind[lane, i]
        if kind < FIRST_HAIR:
            return True
        if LAST_DIFFUSE < kind <= LAST_MICROFACET:
            if closures.param[lane, i, ALPHA_X] * closures.param[lane, i, ALPHA_Y] >= _LEAST_ROUGH:
                return True
    return False


@kernel
def ratio_at(ng, wi, pdf):
    """`PhotonLanes.ratio` of a surface for a direction that its BSDF samples with density `pdf` [sr^-1]."""
    return max(abs(dot(ng, wi)), LEAST_COSINE) / pdf


@kernel
def expected_photons(ratio, density, numbers):
    """Photons that gathering finds on average for each time that paths would find the same light.

    What photons count of it is their share of all: n / (1 + n).

    Parameters
    ----------
    ratio : float32 [sr]
        `ratio_at` of where photons were gathered.
    density : float32 [m^-2 sr^-1], PHOTON_DENSITY
    numbers : float32 (MAP_NUMBERS,), of the map
    """
    return ratio * density * numbers[MAP_EXPECTED]


@kernel
def caster_receiver(paths, lane, lights):
    """Who asks for light where photons begin: the last caster that the lane's path has met. `Receiver`, and the cosine
    there."""
    direction, n = load(paths.direction, lane), load(paths.mis_normal, lane)
    cosine = dot(n, direction)
    if cosine < 0.0:
        cosine = -cosine
        n = negate(n)
    tree = tree_of_ray(lights, paths.flags[lane])
    return Receiver(load(paths.mis_origin, lane), n, False, False, tree), max(cosine, LEAST_COSINE)


@kernel
def share_of_path(scene, work, lane, pdf, cosine):
    """MIS weight of light that a path has found which photons may find too.

    Parameters
    ----------
    pdf : float32 [sr^-1]
        Of a light sample from the last caster (`caster_receiver`) towards the light; 0: photons never find it.
    cosine : float32, at the caster
    """
    if not pdf > 0.0:
        return np.float32(1.0)
    density = pdf * work.photons.place_density[lane] / cosine
    expected = expected_photons(work.photons.ratio[lane], density, scene.photons.numbers)
    return np.float32(1.0) / (np.float32(1.0) + expected)
