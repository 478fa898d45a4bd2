# SPDX-License-Identifier: GPL-3.0-or-later
"""Maps from the unit square to the shapes lights are made of, low in distortion so that stratification survives."""

import math

from engine.kernels.constants import HALF_PI, INV_FOUR_PI, INV_PI, PI, TWO_PI
from engine.kernels.vector import dot, orthonormal_basis, to_world
from engine.runtime.jit import kernel


@kernel
def concentric_disk(u0, u1):
    """Uniform point of the unit disc (Shirley and Chiu 1997)."""
    a = 2.0 * u0 - 1.0
    b = 2.0 * u1 - 1.0
    if a * a > b * b:
        r = a
        phi = 0.25 * PI * (b / a)
    elif b != 0.0:
        r = b
        phi = HALF_PI - 0.25 * PI * (a / b)
    else:
        r = 0.0
        phi = 0.0 * PI
    return r * math.cos(phi), r * math.sin(phi)


@kernel
def one_minus_cos_of_sin_squared(sin_squared):
    """1 - cos of an angle up to pi/2 from its squared sine, exact also where it is tiny."""
    return sin_squared / (1.0 + math.sqrt(max(0.0, 1.0 - sin_squared)))


@kernel
def uniform_cone(axis, one_minus_cos, u0, u1):
    """Direction uniform in solid angle within a cone.

    Returns the unit direction and 1 - cos of its angle with the axis; the pdf is `1 / (2 pi one_minus_cos)`.
    """
    x, y = concentric_disk(u0, u1)
    squared = x * x + y * y
    turned = squared * one_minus_cos
    stretch = math.sqrt(max(0.0, one_minus_cos * (2.0 - turned)))
    tangent, bitangent = orthonormal_basis(axis)
    return to_world((x * stretch, y * stretch, 1.0 - turned), tangent, bitangent, axis), turned


@kernel
def cosine_hemisphere(n, u0, u1):
    """Direction of the hemisphere around `n` and its pdf cos / pi."""
    x, y = concentric_disk(u0, u1)
    z = math.sqrt(max(0.0, 1.0 - x * x - y * y))
    tangent, bitangent = orthonormal_basis(n)
    return to_world((x, y, z), tangent, bitangent, n), z * INV_PI


@kernel
def uniform_sphere(u0, u1):
    """Direction of the whole sphere; the pdf is 1 / (4 pi)."""
    z = 1.0 - 2.0 * u0
    r = math.sqrt(max(0.0, 1.0 - z * z))
    phi = TWO_PI * u1
    return (r * math.cos(phi), r * math.sin(phi), z)


@kernel
def surroundings_pdf(n, wi, has_transmission):
    """Density of directions from within a spherical light: all of them, or the receiver's hemisphere by cosine."""
    if has_transmission:
        return INV_FOUR_PI
    return max(0.0, dot(n, wi)) * INV_PI
