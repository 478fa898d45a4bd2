# SPDX-License-Identifier: GPL-3.0-or-later
"""Ashikhmin and Shirley's glossy reflection, without its Fresnel term (Glossy BSDF, as in Cycles).

References: Ashikhmin and Shirley 2000, "An Anisotropic Phong BRDF Model", Eqs. 4 to 11.
"""

import math

import numpy as np

from engine.kernels.constants import INV_PI, TWO_PI
from engine.kernels.vector import add, dot, normalize, scale, subtract, to_world
from engine.runtime.jit import kernel

#: Up to this roughness it is a mirror (Cycles).
MIRROR_ALPHA = np.float32(1e-4)


@kernel
def _exponent(alpha):
    return 2.0 / (alpha * alpha) - 2.0


@kernel
def _power(alpha_x, alpha_y, x, y, z):
    """z to the exponent that the direction (x, y, z) of a facet has."""
    if z >= 1.0:
        return np.float32(1.0)
    # By sin^2, which near the normal has digits that 1 - z^2 has not.
    squared = x * x + y * y
    e = _exponent(alpha_x)
    if alpha_x != alpha_y and squared > 1e-20:
        e = (e * x * x + _exponent(alpha_y) * y * y) / squared
    return math.exp(0.5 * e * math.log1p(-min(squared, 1.0 - 1e-7)))


@kernel
def eval_ashikhmin_shirley(alpha_x, alpha_y, tangent, bitangent, n, wo, wi):
    """f cos, and density, of a direction."""
    cos_o, cos_i = dot(n, wo), dot(n, wi)
    if cos_o <= 0.0 or cos_i <= 0.0:
        return np.float32(0.0), np.float32(0.0)
    h = normalize(add(wo, wi))
    cos_ho = max(abs(dot(h, wo)), 1e-6)
    norm = math.sqrt((_exponent(alpha_x) + 1.0) * (_exponent(alpha_y) + 1.0)) * (0.125 * INV_PI)
    pdf = norm * _power(alpha_x, alpha_y, dot(h, tangent), dot(h, bitangent), dot(h, n)) / cos_ho
    return pdf * cos_i / max(max(cos_i, cos_o), 1e-6), pdf


@kernel
def sample_ashikhmin_shirley(alpha_x, alpha_y, tangent, bitangent, n, wo, u0, u1):
    """Direction, below the surface where there is no sample."""
    nx, ny = _exponent(alpha_x), _exponent(alpha_y)
    phi = TWO_PI * u0
    if nx != ny:
        # A quadrant's angle goes from 0 to a quarter turn; the others mirror it.
        quadrant = min(int(4.0 * u0), 3)
        within = 4.0 * u0 - np.float32(quadrant)
        if quadrant == 1 or quadrant == 3:
            within = 1.0 - within
        phi = math.atan(math.sqrt((nx + 1.0) / (ny + 1.0)) * math.tan(0.25 * TWO_PI * within))
        if quadrant == 1:
            phi = 0.5 * TWO_PI - phi
        elif quadrant == 2:
            phi = 0.5 * TWO_PI + phi
        elif quadrant == 3:
            phi = TWO_PI - phi
    cosine, sine = math.cos(phi), math.sin(phi)
    e = nx * cosine * cosine + ny * sine * sine + 1.0
    # sin^2 of the facet's angle: 1 - u^(2 / e).
    squared = -math.expm1(2.0 * math.log(max(u1, 1e-20)) / e)
    z = math.sqrt(max(1.0 - squared, 0.0))
    radius = math.sqrt(max(squared, 0.0))
    h = to_world((radius * cosine, radius * sine, z), tangent, bitangent, n)
    return normalize(subtract(scale(h, 2.0 * dot(h, wo)), wo))
