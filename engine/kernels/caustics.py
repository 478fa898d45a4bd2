# SPDX-License-Identifier: GPL-3.0-or-later
"""Light that both paths and photons find: what each counts, and who may.

A photon begins at a place on a caster, in the direction of a light sample there, and goes on by sharp lobes alone:
delta lobes, and all lobes of surfaces that have none but sharp ones (`sends_photons_on`). A path finds the same light
where it leaves a surface that gathers photons, meets sharp lobes alone, and then the lamp or a light sample:
RAY_GATHERED says that the last surface which sent it on by something else gathers photons, RAY_CAUSTIC that the last
sharp lobe behind it was a caster's. Both densities are of the same pair of a place on the lamp and a direction, so that
the chain's own focusing cancels. Of lobes that are no delta it does so but for the facets' shadowing, which all leave
out: so what they count of a light sums to one all the same.

References: Georgiev et al. 2012, "Light Transport Simulation with Vertex Connection and Merging", Eqs. (5) and (7):
the density of merging is that of a photon within the disc; Veach 1997, Eq. (9.8): the balance heuristic.
"""

import numpy as np

from engine.kernels.bsdf import summarize
from engine.kernels.bsdf.kinds import (
    ALPHA_X,
    ALPHA_Y,
    CLOSURE_DISPERSES,
    DELTA_ALPHA_SQUARED,
    FIRST_HAIR,
    HAS_EVAL,
    LAST_DIFFUSE,
    LAST_MICROFACET,
)
from engine.kernels.lights import Receiver, has_blockers, lamp_is_hidden, tree_of_ray
from engine.kernels.vector import dot, load, negate
from engine.runtime.jit import kernel
from engine.state.lanes import RAY_SINGULAR
from engine.state.lights import EMITTER_KIND, EMITTER_LAMP, LAMP_PROGRAM, LIGHT_BACKGROUND, LIGHT_TRIANGLE
from engine.state.photons import MAP_EXPECTED, MAY_GATHER

#: Alpha from which on a lobe is rough: that of a node's roughness of 0.32. Surfaces with one gather photons, those
#: without would show single ones.
LEAST_ROUGH_ALPHA = 0.1
_LEAST_ROUGH = np.float32(LEAST_ROUGH_ALPHA**2)
#: PHOTON_DENSITY of light that no path ever meets, since its lamp has no size: photons count all of it.
UNMET = np.float32(1e20)
#: Bound on cosines by which is divided.
LEAST_COSINE = np.float32(1e-4)


@kernel
def may_gather(scene, closures, lane, instance):
    """Whether a surface is one that gathers photons: it has a lobe that is rough, and does not disperse."""
    if not scene.casters.instances[instance] & MAY_GATHER:
        return False
    if not summarize(closures, lane) & HAS_EVAL or closures.flags[lane] & CLOSURE_DISPERSES:
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
def sends_photons_on(closures, lane):
    """Whether photons go on by all lobes of a surface, and not by its delta lobes alone: sharp ones are all it has.

    Rough lobes that disperse have a density for each wavelength: they are left to paths.
    """
    if closures.flags[lane] & CLOSURE_DISPERSES:
        return False
    is_found = False
    for i in range(closures.count[lane]):
        kind = closures.kind[lane, i]
        if kind <= LAST_DIFFUSE:
            return False
        if kind <= LAST_MICROFACET:
            alphas = closures.param[lane, i, ALPHA_X] * closures.param[lane, i, ALPHA_Y]
            if not alphas < _LEAST_ROUGH:
                return False
            is_found = is_found or bool(alphas > DELTA_ALPHA_SQUARED)
    return is_found


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
def receiver_on_caster(p, n, direction, tree):
    """Who asks for light where photons begin: a place on the side of a caster where light comes from, and the cosine
    there.

    Parameters
    ----------
    p, n : tuple of 3 float32, world space
        The place [m], and the unit shading normal, on either side.
    direction : tuple of 3 float32, unit, towards the light
    tree : int, light tree

    Returns
    -------
    Receiver
    cosine : float32
    """
    cosine = dot(n, direction)
    if cosine < 0.0:
        cosine = -cosine
        n = negate(n)
    return Receiver(p, n, False, False, tree), max(cosine, LEAST_COSINE)


@kernel
def caster_receiver(paths, lane, lights):
    """`receiver_on_caster` at the last caster that the lane's path has met, towards where its ray goes."""
    return receiver_on_caster(
        load(paths.mis_origin, lane), load(paths.mis_normal, lane), load(paths.direction, lane),
        tree_of_ray(lights, paths.flags[lane]),
    )


@kernel
def rays_find(lights, emitter):
    """Whether paths find an emitter behind a delta lobe, wherever light samples there do.

    Where only some objects cast shadows in its light a path has to look for it through the others. It does for lamps
    without nodes alone (`engine.wavefront.hidden_lamps`): light of the others is the photons'.
    """
    kind = lights.emitters[emitter, EMITTER_KIND]
    if kind == LIGHT_TRIANGLE:
        return not has_blockers(lights, emitter)
    if kind == LIGHT_BACKGROUND:
        return True
    row = np.int64(lights.emitters[emitter, EMITTER_LAMP])
    return lights.lamp_table[row, LAMP_PROGRAM] < 0 or not lamp_is_hidden(lights, row)


@kernel
def share_of_scattering(bsdf_pdf, light_pdf):
    """What of a density of photons counts where paths have light samples too, of lobes that are no delta.

    Photons are weighed against both ways of paths together: n / (1 + n + light_pdf / bsdf_pdf), n times this share
    being what `expected_photons` is told instead of n.
    """
    return bsdf_pdf / (bsdf_pdf + light_pdf)


@kernel
def share_beside_photons(scene, work, lane, density):
    """MIS weight of light that a path finds, and photons that begin with this density, PHOTON_DENSITY."""
    expected = expected_photons(work.photons.ratio[lane], density, scene.photons.numbers)
    return np.float32(1.0) / (np.float32(1.0) + expected)


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
    if not work.paths.flags[lane] & RAY_SINGULAR:
        density *= share_of_scattering(work.paths.unguided_pdf[lane], pdf)
    return share_beside_photons(scene, work, lane, density)
