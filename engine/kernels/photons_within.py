# SPDX-License-Identifier: GPL-3.0-or-later
"""Photons within media: where they may be, and how many come for each path that finds the same light.

A photon leaves marks on each of its segments, drawn as a path draws where it collides; a path gathers those within a
cylinder about a part of each of its own. What `engine.kernels.caustics` says holds here too, with these densities for a
direction at a collision: a photon's mark is there with the density of how the photon began times that of a collision a
metre; a path comes along the same way with the phase functions' density, having collided. How likely it is to pass from
there to the caster without a collision is the same both ways, so of the photon's density nothing is left but the
extinction. The path's place is drawn within its segment for sure, which makes photons as many times more likely as a
collision on the segment is not.

References: Georgiev et al. 2012, Eqs. (5) and (7); Krivanek et al. 2014, "Unifying Points, Beams, and Paths in
Volumetric Light Transport Simulation", section 5.
"""

import numpy as np

from engine.kernels.media import last_medium
from engine.runtime.jit import kernel
from engine.state.media import EXTINCTION, WORLD
from engine.state.photons import MAP_EXPECTED, MAP_TUBE_EXPECTED, MAY_GATHER


@kernel
def may_gather_within(scene, media, lane):
    """Whether photons are kept and gathered in all that a lane is in: it stands still."""
    for entry in range(media.count[lane]):
        instance = media.instance[lane, entry]
        if instance != WORLD and not scene.casters.instances[instance] & MAY_GATHER:
            return False
    return media.count[lane] > 0


@kernel
def mean_extinction(channels, coefficients):
    """Of all channels [m^-1]: the density of a photon's marks a metre, but for what dims them all alike."""
    total = np.float32(0.0)
    for c in range(len(channels)):
        total += coefficients[EXTINCTION, c]
    return total / np.float32(len(channels))


@kernel
def ratio_within(numbers, extinction, phase_pdf, share):
    """`PhotonLanes.ratio` of a collision [sr]: as if it had gathered within the disc of a surface.

    Parameters
    ----------
    numbers : float32 (MAP_NUMBERS,), of the map
    extinction : float32 [m^-1], `mean_extinction`
    phase_pdf : float32 [sr^-1], above 0
    share : float32
        Probability that the path collides on its segment.
    """
    if not numbers[MAP_EXPECTED] > 0.0 or not share > 0.0:
        return np.float32(0.0)
    return extinction * numbers[MAP_TUBE_EXPECTED] / (phase_pdf * share * numbers[MAP_EXPECTED])


@kernel
def name_of_medium(media, lane):
    """What tells photons in one medium from those in another: float32."""
    return np.float32(last_medium(media, lane))
