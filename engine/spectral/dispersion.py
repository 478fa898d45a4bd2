# SPDX-License-Identifier: GPL-3.0-or-later
"""Refractive index over wavelength: Cauchy's formula of two terms, n = A + B / lambda^2.

A material's `dispersion` D [um^2] is B / (n_d - 1), which does not depend on the index: a node's own IOR stays the
index at the d line, n(lambda) = n_d + (n_d - 1) D (1 / lambda^2 - 1 / lambda_d^2). 0 is no dispersion, n_d exactly. An
Abbe number V_d = (n_d - 1) / (n_F - n_C) gives D = 1 / (V_d (1 / lambda_F^2 - 1 / lambda_C^2)).
"""

from __future__ import annotations

import math

import numpy as np

from engine.runtime.jit import kernel

#: Fraunhofer's lines F, d and C [nm].
LINE_F = 486.1
LINE_D = 587.6
LINE_C = 656.3

_D_INVERSE_SQUARE = np.float32(1e6 / LINE_D**2)
#: Least index: what disperses strongly enough to reach it is not a material.
_LEAST_IOR = np.float32(1e-3)


def dispersion_from_abbe(abbe_number: float) -> float:
    """Dispersion of a glass.

    Parameters
    ----------
    abbe_number : float
        V_d; low is strong. Nothing disperses if it is not positive or not finite.

    Returns
    -------
    float  [um^2], B / (n_d - 1)
    """
    if not (math.isfinite(abbe_number) and abbe_number > 0.0):
        return 0.0
    return 1.0 / (abbe_number * 1e6 * (LINE_F**-2 - LINE_C**-2))


def dispersion_from_cauchy(a: float, b: float) -> float:
    """Dispersion of Cauchy's coefficients, to be used at whatever IOR the node has.

    Parameters
    ----------
    a : float
    b : float  [um^2]

    Returns
    -------
    float  [um^2], B / (n_d - 1)
        0 where the index at the d line is 1 or something is not finite.
    """
    above_one = a + b * 1e6 / LINE_D**2 - 1.0
    if not (math.isfinite(above_one) and math.isfinite(b)) or abs(above_one) < 1e-6:
        return 0.0
    return b / above_one


@kernel
def ior_at(ior_d, dispersion, wavelength):
    """Refractive index at a wavelength.

    Parameters
    ----------
    ior_d : float32
        Index at 587.6 nm, the node's.
    dispersion : float32  [um^2]
        B / (n_d - 1); 0 gives `ior_d` itself.
    wavelength : float32  [nm]

    Returns
    -------
    float32
        At least 1e-3, or `ior_d` if that is less.
    """
    if dispersion == 0.0:
        return ior_d
    micrometres = 1e-3 * wavelength
    n = ior_d + (ior_d - 1.0) * dispersion * (1.0 / (micrometres * micrometres) - _D_INVERSE_SQUARE)
    return n if n > _LEAST_IOR else _LEAST_IOR
