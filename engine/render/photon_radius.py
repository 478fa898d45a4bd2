# SPDX-License-Identifier: GPL-3.0-or-later
"""Within which radius photons are gathered: that of the least error where photons alone know the light.

A large disc blurs, a small one has few photons. Squared bias goes with the radius to the fourth power and noise with
one over its square, so that the best radius falls with the number of photons to the power of -1/6, as radii of photon
maps do: what is best for the first of them is so for all.

References: Silverman 1986, "Density Estimation for Statistics and Data Analysis", section 4.3.1: the best width in two
dimensions.
"""

from __future__ import annotations

import math

import numpy as np

from engine.array_types import Float32Array, FloatArray
from engine.runtime.jit import kernel
from engine.state.photons import PHOTON_P, PHOTON_POWER

#: Most and fewest photons within a disc: more cost more than they bring.
MOST_NEIGHBOURS, FEWEST_NEIGHBOURS = 64, 6
#: What squared bias counts beside noise: the mean of maps has 1.5 times the bias of the last, and no denoiser takes it
#: away.
BIAS_COUNTS = 4.0
#: Neighbours within the larger of the two discs that are compared, and how much smaller the other one's radius is.
_COMPARED, _SMALLER = 128, 0.5
#: Photons at whose places discs are looked at, and most photons that are counted there.
_ASKED, _COUNTED = 512, 1 << 15
#: Photons at whose places neighbours are counted, and the least number of these.
_ASKED_FOR_NEIGHBOURS, _LEAST_NEIGHBOURS = 128, 8
#: See `radius_of_neighbours`; and this quantile of the normal distribution.
_NEARER, _QUANTILE = 0.25, -0.6745
#: Radius where too few photons arrive to tell, over the square root of the casters' area.
_LARGE = 0.05


def squared_distances(photons: Float32Array, neighbours: int, asked_count: int, one_in: int = 1) -> FloatArray:
    """From some photons to the last of so many neighbours: float64 [m^2].

    Parameters
    ----------
    photons : float32 (P, PHOTON_WIDTH or more)
    neighbours : int, below the number of those that are looked at
    asked_count : int, about
    one_in : int
        Of all photons one in so many is looked at.
    """
    places = photons[:, PHOTON_P : PHOTON_P + 3].astype(np.float64)
    asked, among = places[:: max(len(places) // asked_count, 1)], places[::one_in]
    return np.array([np.partition(((among - place) ** 2).sum(axis=1), neighbours)[neighbours] for place in asked])


def radius_of_neighbours(photons: Float32Array, neighbours: int, caster_area: float) -> float:
    """Radius of a disc that holds so many neighbours where a quarter of the photons lie more densely [m].

    Those that lie densely make bright light; the others may lie anywhere, and far outside of the picture.

    Parameters
    ----------
    photons : float32 (P, PHOTON_WIDTH)
    neighbours : int
    caster_area : float [m^2]
        Says it where there are no photons.
    """
    neighbours = min(neighbours, len(photons) - 1)
    if neighbours < 1:
        return _LARGE * math.sqrt(caster_area)
    # Of all photons one in so many, which lie that much less densely.
    one_in = max(neighbours // _LEAST_NEIGHBOURS, 1)
    neighbours //= one_in
    squared = squared_distances(photons, neighbours, _ASKED_FOR_NEIGHBOURS, one_in)
    # That quantile of the gamma distribution, over its mean (Wilson and Hilferty 1931).
    chance = (1.0 - 1.0 / (9.0 * neighbours) + _QUANTILE / (3.0 * math.sqrt(neighbours))) ** 3
    radius = math.sqrt(float(np.quantile(squared, _NEARER)) / chance)
    return radius if radius > 0.0 else _LARGE * math.sqrt(caster_area)


def neighbours_within(photons: Float32Array, radius: float, caster_area: float) -> float:
    """Photons within a disc of that radius [m] where a quarter of them lie more densely (`radius_of_neighbours`)."""
    neighbours = min(MOST_NEIGHBOURS, len(photons) - 1)
    return max(neighbours, 0) * (radius / radius_of_neighbours(photons, neighbours, caster_area)) ** 2


@kernel
def _look_at_discs(asked, places, power, squared, smaller_squared, found):
    """Add up what photons bring within two discs about each of some places.

    Parameters
    ----------
    asked, places : float32 (A, 3), (P, 3) [m]
    power : float32 (P,)
    squared, smaller_squared : float32, of the discs' radii [m^2]
    found : float64 (A, 5), zeros; filled with how many photons lie within the larger disc, what the even ones of them
        bring there and within the smaller one, and what the odd ones bring
    """
    for k in range(asked.shape[0]):
        for row in range(places.shape[0]):
            x, y, z = places[row, 0] - asked[k, 0], places[row, 1] - asked[k, 1], places[row, 2] - asked[k, 2]
            distance = x * x + y * y + z * z
            # The photon itself says nothing of others.
            if distance > squared or distance == 0.0:
                continue
            column = 1 + 2 * (row & 1)
            found[k, 0] += 1.0
            found[k, column] += power[row]
            if distance <= smaller_squared:
                found[k, column + 1] += power[row]


def best_radius(photons: Float32Array, caster_area: float) -> float:
    """The radius with the least squared error, which so many photons leave [m].

    Parameters
    ----------
    photons : float32 (P, PHOTON_WIDTH)
    caster_area : float [m^2]
    """
    most = radius_of_neighbours(photons, MOST_NEIGHBOURS, caster_area)
    one_in = -(-len(photons) // _COUNTED)
    counted = photons[::one_in] if one_in > 1 else photons
    if len(counted) < 2 * _COMPARED:
        return most
    larger = radius_of_neighbours(counted, _COMPARED, caster_area)
    squared = larger * larger
    places = np.ascontiguousarray(counted[:, PHOTON_P : PHOTON_P + 3])
    power = np.abs(counted[:, PHOTON_POWER : PHOTON_POWER + 3]).mean(axis=1)
    asked = np.ascontiguousarray(places[:: max(len(places) // _ASKED, 1)])
    found = np.zeros((len(asked), 5))
    _look_at_discs(asked, places, power, np.float32(squared), np.float32(squared * _SMALLER**2), found)
    bias, noise = _bias_and_noise(found, power.astype(np.float64))
    noise /= one_in
    least = most * math.sqrt(FEWEST_NEIGHBOURS / MOST_NEIGHBOURS)
    if not bias > 0.0:
        return most
    # Where the derivative of bias r^4 + noise / r^2 is 0.
    return min(max(larger * (noise / (2.0 * BIAS_COUNTS * bias)) ** (1.0 / 6.0), least), most)


def _bias_and_noise(found: FloatArray, power: FloatArray) -> tuple[float, float]:
    """Squared bias and variance within the larger disc, relative to its light, of what `_look_at_discs` has found.

    Both halves of the photons say how much brighter the smaller disc is, so that the mean of the product of what they
    say has no noise in it.
    """
    count, even, even_smaller, odd, odd_smaller = found.T
    difference = (even - even_smaller / _SMALLER**2) * (odd - odd_smaller / _SMALLER**2)
    light = float((even * odd).sum())
    if not light > 0.0:
        return 0.0, 0.0
    effective = power.sum() ** 2 / ((power**2).sum() * len(power))
    bias = float(difference.sum()) / light / (1.0 - _SMALLER**2) ** 2
    return bias, float(count.sum() / ((count**2).sum() * effective))
