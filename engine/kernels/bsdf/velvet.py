# SPDX-License-Identifier: GPL-3.0-or-later
"""Ashikhmin's velvet: the Sheen BSDF of Blender 3 and its Ashikhmin distribution since.

References: Ashikhmin, Premoze and Shirley 2000, "A Microfacet-based BRDF Generator", section 5.2 (as in Cycles).
"""

import math

import numpy as np

from engine.kernels.constants import INV_PI, TWO_PI
from engine.kernels.vector import add, dot, normalize, orthonormal_basis, to_world
from engine.runtime.jit import kernel


@kernel
def eval_velvet(sharpness, n, wo, wi):
    """f cos, and density, of a direction; `sharpness` is 1 / sigma^2."""
    cos_o, cos_i = dot(n, wo), dot(n, wi)
    if cos_i <= 0.0:
        return np.float32(0.0), np.float32(0.0)
    pdf = 0.5 * INV_PI
    h = normalize(add(wo, wi))
    cos_h, cos_ho = dot(n, h), abs(dot(wo, h))
    if not (cos_o > 0.0 and abs(cos_h) < 1.0 - 1e-5 and cos_ho > 1e-5):
        return np.float32(0.0), pdf
    ratio = 2.0 * max(cos_h / cos_ho, 1e-5)
    shadowing = min(1.0, min(ratio * cos_o, ratio * cos_i))
    squared = 1.0 - cos_h * cos_h
    density = math.exp(-cos_h * cos_h / squared * sharpness) * sharpness * INV_PI / (squared * squared)
    return 0.25 * density * shadowing / cos_o, pdf


@kernel
def sample_velvet(n, u0, u1):
    """Direction, uniform over the hemisphere."""
    radius = math.sqrt(max(1.0 - u0 * u0, 0.0))
    phi = TWO_PI * u1
    tangent, bitangent = orthonormal_basis(n)
    return to_world((radius * math.cos(phi), radius * math.sin(phi), u0), tangent, bitangent, n)
