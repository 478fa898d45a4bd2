# SPDX-License-Identifier: GPL-3.0-or-later
"""Beckmann's distribution of microfacets: density, masking and visible normals.

References: Walter et al. 2007, "Microfacet Models for Refraction through Rough Surfaces", Eq. 25; Heitz 2014,
"Understanding the Masking-Shadowing Function in Microfacet-Based BRDFs", Eq. 68; Heitz and d'Eon 2014, "Importance
Sampling Microfacet-Based BSDFs using the Distribution of Visible Normals"; Jakob 2014, "An Improved Visible Normal
Sampling Routine for the Beckmann Distribution"; Giles 2012, "Approximating the erfinv Function".
"""

import math

import numpy as np

from engine.kernels.constants import INV_PI, TWO_PI
from engine.kernels.vector import normalize
from engine.runtime.jit import kernel

_INV_SQRT_PI = np.float32(1.0 / math.sqrt(math.pi))
_NEWTON_STEPS = 6


@kernel
def erf_inverse(x):
    """Inverse of the error function, for x in (-1, 1)."""
    w = -math.log(max((1.0 - x) * (1.0 + x), 1e-30))
    if w < 5.0:
        w -= 2.5
        p = 2.81022636e-08
        p = 3.43273939e-07 + p * w
        p = -3.5233877e-06 + p * w
        p = -4.39150654e-06 + p * w
        p = 0.00021858087 + p * w
        p = -0.00125372503 + p * w
        p = -0.00417768164 + p * w
        p = 0.246640727 + p * w
        p = 1.50140941 + p * w
        return p * x
    w = math.sqrt(w) - 3.0
    p = -0.000200214257
    p = 0.000100950558 + p * w
    p = 0.00134934322 + p * w
    p = -0.00367342844 + p * w
    p = 0.00573950773 + p * w
    p = -0.0076224613 + p * w
    p = 0.00943887047 + p * w
    p = 1.00167406 + p * w
    p = 2.83297682 + p * w
    return p * x


@kernel
def beckmann_lambda(stretched):
    """Smith's Lambda of a direction whose (alpha tan(theta))^2 is `stretched`."""
    if stretched < 0.01:
        return np.float32(0.0)
    a = 1.0 / math.sqrt(stretched)
    return 0.5 * (math.erf(a) - 1.0) + 0.5 * _INV_SQRT_PI * math.exp(-a * a) / a


@kernel
def approximate_lambda(stretched):
    """`beckmann_lambda` by Walter's rational function (p. 8), as Cycles has it: values are up to 1% off by it."""
    if stretched < 0.39:
        return np.float32(0.0)
    a = 1.0 / math.sqrt(stretched)
    return ((0.396 * a - 1.259) * a + 1.0) / ((2.181 * a + 3.535) * a)


@kernel
def beckmann_density(x, y, cos_h, alpha_squared):
    """Density of a facet's normal: `x`, `y` are its components along the axes over their alphas."""
    squared = cos_h * cos_h
    if not squared > 1e-12:
        return np.float32(0.0)
    return math.exp(-(x * x + y * y) / squared) * INV_PI / (alpha_squared * squared * squared)


@kernel
def _visible_slope(cosine, sine, u):
    """Slope along the view of a visible facet of alpha 1, seen under an angle of `cosine`."""
    tangent = sine / cosine
    cotangent = cosine / sine
    k = tangent * _INV_SQRT_PI
    low = np.float32(-1.0)
    high = math.erf(cotangent)
    total = 1.0 + high + k * math.exp(-cotangent * cotangent)
    wanted = u * total
    # The distribution is 1 + b + k exp(-erfinv(b)^2) with b the slope's error function; exp(..) is nearly 1 - b^2.
    inner = k * (k - u * (1.0 + high + k * (1.0 - high * high)) + 1.0) + 0.25
    b = (0.5 - math.sqrt(max(inner, 0.0))) / k
    b = min(max(b, low), high)
    slope = erf_inverse(b)
    for _ in range(_NEWTON_STEPS):
        excess = 1.0 + b + k * math.exp(-slope * slope) - wanted
        if abs(excess) < 1e-6 * total:
            break
        if excess > 0.0:
            high = b
        else:
            low = b
        b -= excess / (1.0 - slope * tangent)
        if not (b >= low and b <= high):
            b = 0.5 * (low + high)
        slope = erf_inverse(b)
    return slope


@kernel
def sample_beckmann_normal(wo, alpha_x, alpha_y, u0, u1):
    """Visible normal of Beckmann's distribution for `wo` in the lobe's frame, wo.z > 0."""
    stretched = normalize((alpha_x * wo[0], alpha_y * wo[1], wo[2]))
    sine = math.sqrt(stretched[0] * stretched[0] + stretched[1] * stretched[1])
    u0 = min(max(u0, 1e-6), 1.0 - 1e-6)
    u1 = min(max(u1, 1e-6), 1.0 - 1e-6)
    if sine < 1e-3:
        radius = math.sqrt(-math.log(u0))
        slope_x = radius * math.cos(TWO_PI * u1)
        slope_y = radius * math.sin(TWO_PI * u1)
    else:
        along = _visible_slope(stretched[2], sine, u0)
        across = erf_inverse(2.0 * u1 - 1.0)
        x, y = stretched[0] / sine, stretched[1] / sine
        slope_x = x * along - y * across
        slope_y = y * along + x * across
    return normalize((-alpha_x * slope_x, -alpha_y * slope_y, np.float32(1.0)))
