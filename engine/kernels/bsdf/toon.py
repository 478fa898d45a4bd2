# SPDX-License-Identifier: GPL-3.0-or-later
"""Toon BSDF: light from a cone, evenly, and less of it towards the cone's rim. As in Cycles.

The cone is about the normal (diffuse) or about the mirrored view (glossy).
"""

import math

import numpy as np

from engine.kernels.constants import HALF_PI, TWO_PI
from engine.kernels.vector import dot, length, orthonormal_basis, subtract, to_world
from engine.runtime.jit import kernel


@kernel
def _one_minus_cos(angle):
    sine = math.sin(0.5 * angle)
    return 2.0 * sine * sine


@kernel
def eval_toon(size, rim, axis, wi):
    """f cos, and density, of a direction.

    The angle with the cone's axis is told by the chord between both: a cosine near 1 has too few bits for small cones.

    Parameters
    ----------
    size, rim : float32 [radians]
        The even cone, and how much wider the rim is.
    axis, wi : tuple of 3 float32
        Of the cone, and the direction; both unit.
    """
    widest = min(size + rim, HALF_PI)
    angle = 2.0 * math.asin(min(0.5 * length(subtract(axis, wi)), 1.0))
    if angle >= widest:
        return np.float32(0.0), np.float32(0.0)
    pdf = 1.0 / (TWO_PI * _one_minus_cos(widest))
    if angle < size:
        return pdf, pdf
    return pdf * (1.0 - (angle - size) / rim), pdf


@kernel
def sample_toon(size, rim, axis, u0, u1):
    """Direction in the cone, uniform."""
    below = u0 * _one_minus_cos(min(size + rim, HALF_PI))
    radius = math.sqrt(max(below * (2.0 - below), 0.0))
    tangent, bitangent = orthonormal_basis(axis)
    phi = TWO_PI * u1
    return to_world((radius * math.cos(phi), radius * math.sin(phi), 1.0 - below), tangent, bitangent, axis)


@kernel
def mirrored(n, wo):
    """The view mirrored at the normal."""
    along = 2.0 * dot(n, wo)
    return along * n[0] - wo[0], along * n[1] - wo[1], along * n[2] - wo[2]
