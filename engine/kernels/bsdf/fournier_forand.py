# SPDX-License-Identifier: GPL-3.0-or-later
"""Fournier and Forand's phase function, of particles in water: a peak ahead that has no top, and an even back.

Angles are given by s, the squared sine of half of them: of 1e-7 rad a float32 cosine knows nothing. With
x = `delta` s, `delta` being 4 / (3 (n - 1)^2) of particles of refractive index n, and `exponent` a in (0, 1), which is
Fournier and Forand's -nu, what goes by less than an angle is

    F(s) = (x^a (1 - s) + s - x) / (1 - x) + c s (1 - s) (1 - 2 s) / 2, where c = (delta^a - 1) / (delta - 1),

and the function is its derivative over 4 pi.

References
----------
Fournier and Forand 1994, "Analytic phase function for ocean water", Eqs. (11) to (14).
Fournier and Jonasz 1999, "Computer-based underwater imaging analysis", Eqs. (1) to (5).
"""

import math

import numpy as np

from engine.kernels.constants import INV_FOUR_PI
from engine.kernels.vector import add, dot
from engine.runtime.jit import kernel

#: Squared half sines below which the peak is level: of unit vectors smaller ones are rounding errors.
_LEAST = np.float32(1e-16)
#: How near to 1 x is when quotients by 1 - x become series, and their terms.
_NEAR = np.float32(0.1)
_TERMS = 8
#: Steps towards the angle to a random number, and how near to that is near enough.
_MOST_STEPS = 16
_PRECISION = np.float32(1e-7)


@kernel
def half_sine_squared(wo, wi):
    """Squared sine of half the angle by which light is scattered, precise for small ones."""
    turned = add(wo, wi)
    return min(0.25 * dot(turned, turned), 1.0)


@kernel
def _backward(delta, exponent):
    """c: of the part that Fournier and Forand add for large angles."""
    left = delta - 1.0
    if abs(left) < 1e-3:
        return exponent * (1.0 + 0.5 * (exponent - 1.0) * left)
    return (math.exp(exponent * math.log(delta)) - 1.0) / left


@kernel
def _distribution(s, power, exponent, delta, c):
    """F(s) and its derivative, where `power` is (`delta` s)^`exponent`."""
    x = delta * s
    left = 1.0 - x
    cosine = 1.0 - 2.0 * s
    share = 0.5 * c * s * (1.0 - s) * cosine
    if abs(left) > _NEAR:
        share += (power * (1.0 - s) + s - x) / left
        slope = (exponent * power / x - (1.0 - power) / left) / left
    else:
        # (1 - x^a) / (a (1 - x)), and how fast x^(a - 1) moves away from it.
        term, quotient, slope, step = 1.0 + 0.0 * s, 1.0 + 0.0 * s, 0.0 * s, 1.0 + 0.0 * s
        for index in range(1, _TERMS):
            j = np.float32(index)
            term *= (j - exponent) / j
            slope += term * step * j / (j + 1.0)
            step *= left
            quotient += term * step / (j + 1.0)
        share += 1.0 - exponent * quotient * (1.0 - s)
        slope *= exponent
    density = (delta - 1.0) * slope + exponent * power / x + 0.25 * c * (3.0 * cosine * cosine - 1.0)
    return share, density


@kernel
def eval_fournier_forand(s, exponent, delta):
    """Density [sr^-1] of scattering by an angle; s is its `half_sine_squared`."""
    s = max(s, _LEAST)
    power = math.exp(exponent * math.log(delta * s))
    _share, density = _distribution(s, power, exponent, delta, _backward(delta, exponent))
    return INV_FOUR_PI * max(density, 0.0)


@kernel
def sample_fournier_forand(u, exponent, delta):
    """Squared sine of half the angle that a share `u` of the light is scattered by less than.

    Newton's method in s^`exponent`, by which F is next to linear at the peak, between bounds.
    """
    if not u > 0.0:
        return 0.0 * u
    c = _backward(delta, exponent)
    scale = math.exp(exponent * math.log(delta))
    low, high = 0.0 * u, 1.0 + 0.0 * u
    y = min(u / scale, 1.0)
    s = 0.0 * u
    for _step in range(_MOST_STEPS):
        s = math.exp(math.log(y) / exponent)
        share, slope = scale * y, scale
        if s > _LEAST:
            share, density = _distribution(s, scale * y, exponent, delta, c)
            slope = density * s / (exponent * y)
        if abs(share - u) <= _PRECISION:
            break
        if share < u:
            low = y
        else:
            high = y
        y += (u - share) / slope if slope > 0.0 else 0.0
        if not low < y < high:
            y = 0.5 * (low + high)
    return min(s, 1.0)
