# SPDX-License-Identifier: GPL-3.0-or-later
"""Maps from the unit square that keep strata together, without trigonometric calls."""

import math

import numpy as np

from engine.kernels.vector import orthonormal_basis, to_world
from engine.runtime.jit import kernel

QUARTER_PI = np.float32(0.25 * math.pi)


@kernel
def concentric_disk(u0, u1):
    """Point (x, y) of the unit disk, uniform by area.

    The angle within an octant pair is at most pi / 4, where short Taylor series reach float32 precision.

    References: Shirley and Chiu 1997, "A Low Distortion Map Between Disk and Square".
    """
    a = 2.0 * u0 - 1.0
    b = 2.0 * u1 - 1.0
    is_wide = abs(a) > abs(b)
    radius = a if is_wide else b
    other = b if is_wide else a
    if radius == 0.0:
        return 0.0, 0.0
    angle = QUARTER_PI * (other / radius)
    x2 = angle * angle
    sine = angle * (1.0 + x2 * (-1.0 / 6.0 + x2 * (1.0 / 120.0 + x2 * (-1.0 / 5040.0 + x2 * (1.0 / 362880.0)))))
    cosine = 1.0 + x2 * (-0.5 + x2 * (1.0 / 24.0 + x2 * (-1.0 / 720.0 + x2 * (1.0 / 40320.0))))
    along = radius * cosine
    across = radius * sine
    return (along, across) if is_wide else (across, along)


@kernel
def sample_cosine_hemisphere(n, u0, u1):
    """Unit direction around unit `n` with density cos(theta) / pi, and cos(theta)."""
    x, y = concentric_disk(u0, u1)
    z = math.sqrt(max(1.0 - x * x - y * y, 0.0))
    tangent, bitangent = orthonormal_basis(n)
    return to_world((x, y, z), tangent, bitangent, n), z


@kernel
def sample_cosine(param, lane, i, n, wo, u1, u2):
    """`sample_cosine_hemisphere` as the `Lobe.sample` of closure `i`."""
    wi, _ = sample_cosine_hemisphere(n, u1, u2)
    return wi
