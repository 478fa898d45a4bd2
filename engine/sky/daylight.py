# SPDX-License-Identifier: GPL-3.0-or-later
"""Skies that are formulas of the angles to the zenith and to the sun.

References: Preetham, Shirley and Smits 1999, "A Practical Analytic Model for Daylight"; Hosek and Wilkie 2012, "An
Analytic Model for Full Spectral Sky-Dome Radiance", whose fitted numbers `hosek_wilkie.npz` holds (BSD-3-Clause, see
`hosek_wilkie_license.txt`).

With t the angle to the zenith and g that to the sun, both are, channel by channel, `radiance` times

    (1 + c0 exp(c1 / (cos t + horizon))) (c2 + c3 exp(c4 g) + c5 cos^2 g + c6 mie(g, c8) + c7 sqrt(cos t))

and mie(g, h) = (1 + cos^2 g) / (1 + h^2 - 2 h cos g)^1.5.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np

from engine.array_types import FloatArray

#: Kept off the horizon by this [rad], where the formulas end.
ABOVE_HORIZON = 0.001
_NUMBERS = Path(__file__).parent / "hosek_wilkie.npz"
#: Zenith, by powers 3 to 0 of the sun's angle to the zenith, by powers 2 to 0 of turbidity: chromaticities x and y.
_ZENITH_X = np.array(
    [
        [0.00166, -0.00375, 0.00209, 0.0], [-0.02903, 0.06377, -0.03202, 0.00394], [0.11693, -0.21196, 0.06052, 0.25886]
    ]
)  # fmt: skip
_ZENITH_Y = np.array(
    [
        [0.00275, -0.0061, 0.00317, 0.0], [-0.04214, 0.0897, -0.04153, 0.00516], [0.15346, -0.26756, 0.0667, 0.26688]
    ]
)  # fmt: skip
#: Perez' five coefficients by turbidity, of luminance, x and y: slope and value at 0.
_PEREZ = np.array(
    [
        [[0.1787, -1.463], [-0.3554, 0.4275], [-0.0227, 5.3251], [0.1206, -2.5771], [-0.067, 0.3703]],
        [[-0.0193, -0.2592], [-0.0665, 0.0008], [-0.0004, 0.2125], [-0.0641, -0.8989], [-0.0033, 0.0452]],
        [[-0.0167, -0.2608], [-0.095, 0.0092], [-0.0079, 0.2102], [-0.0441, -1.6537], [-0.0109, 0.0529]],
    ]
)


@dataclass(frozen=True)
class Daylight:
    """Numbers of the formula.

    Attributes
    ----------
    coefficients : float64 (3, 9)
    radiance : float64 (3,)
    theta, phi : float [rad]
        The sun's angle to the zenith, and its azimuth from y towards x.
    horizon : float
        Added to the cosine to the zenith.
    is_chromatic : bool
        Channels are luminance Y and the chromaticities x and y, else CIE X, Y and Z.
    """

    coefficients: FloatArray
    radiance: FloatArray
    theta: float
    phi: float
    horizon: float
    is_chromatic: bool


def _angles(direction: tuple[float, float, float]) -> tuple[float, float]:
    x, y, z = direction
    return math.acos(min(max(z, -1.0), 1.0)), math.atan2(x, y)


def preetham(direction: tuple[float, float, float], turbidity: float) -> Daylight:
    """The sky of a sun in a unit direction."""
    theta, phi = _angles(direction)
    turbidities = np.array([turbidity * turbidity, turbidity, 1.0])
    powers = np.array([theta**3, theta**2, theta, 1.0])
    chi = (4.0 / 9.0 - turbidity / 120.0) * (math.pi - 2.0 * theta)
    luminance = (4.0453 * turbidity - 4.9710) * math.tan(chi) - 0.2155 * turbidity + 2.4192
    zenith = np.array([0.06 * luminance, turbidities @ _ZENITH_X @ powers, turbidities @ _ZENITH_Y @ powers])
    perez = _PEREZ @ np.array([turbidity, 1.0])
    a, b, c, d, e = perez.T
    at_zenith = (1.0 + a * np.exp(b)) * (1.0 + c * np.exp(d * theta) + e * math.cos(theta) ** 2)
    nothing = np.zeros(3)
    coefficients = np.stack([a, b, np.ones(3), c, d, e, nothing, nothing, nothing], axis=1)
    return Daylight(coefficients, zenith / at_zenith, theta, phi, 0.0, True)


@cache
def _fit() -> tuple[FloatArray, FloatArray]:
    """Coefficients by (channel, albedo 0 and 1, turbidity 1 to 10, control point, coefficient), and radiances so."""
    with np.load(_NUMBERS) as numbers:
        return numbers["coefficients"], numbers["radiances"]


def hosek_wilkie(direction: tuple[float, float, float], turbidity: float, albedo: float) -> Daylight:
    """The sky of a sun in a unit direction, over ground of an albedo in [0, 1]."""
    theta, phi = _angles(direction)
    theta = min(max(theta, 0.0), 0.5 * math.pi)
    turbidity = min(max(turbidity, 1.0), 10.0)
    x = (1.0 - theta / (0.5 * math.pi)) ** (1.0 / 3.0)
    bezier = np.array([math.comb(5, k) * (1.0 - x) ** (5 - k) * x**k for k in range(6)])
    lower = min(int(turbidity), 9)
    part = turbidity - lower
    weights = np.outer([1.0 - albedo, albedo], [1.0 - part, part])
    coefficients, radiances = (table[:, :, lower - 1 : lower + 1] for table in _fit())
    cooked = np.einsum("at,p,catpk->ck", weights, bezier, coefficients)
    radiance = np.einsum("at,p,catp->c", weights, bezier, radiances)
    return Daylight(cooked, radiance * (2.0 * math.pi / 683.0), theta, phi, 0.01, False)
