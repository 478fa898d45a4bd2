# SPDX-License-Identifier: GPL-3.0-or-later
"""Planck's law relative to D65, as all spectra are, scaled to luminance 1."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from engine.runtime.jit import kernel
from engine.spectral.observer import D65, GRID, LONGEST, SHORTEST, d65, integrate, xyz_matching

#: Second radiation constant h c / k [nm K].
RADIATION_CONSTANT = 1.438776877e7
#: Temperatures are clamped to these [K].
LOWEST_TEMPERATURE = 500.0
HIGHEST_TEMPERATURE = 1e6
#: Entries of the table over 1 / temperature, from 0 to that of the lowest temperature.
TEMPERATURE_NODES = 513
WAVELENGTH_NODES = len(D65)

_RADIATION = np.float32(RADIATION_CONSTANT)
#: Where spectra are compared [nm].
_REFERENCE = 560.0
_REFERENCE_32 = np.float32(_REFERENCE)
_LOWEST = np.float32(LOWEST_TEMPERATURE)
_HIGHEST = np.float32(HIGHEST_TEMPERATURE)
_NODES_PER_KELVIN = np.float32((TEMPERATURE_NODES - 1) * LOWEST_TEMPERATURE)
_SHORTEST = np.float32(SHORTEST)
_NODES_PER_NM = np.float32((WAVELENGTH_NODES - 1) / (LONGEST - SHORTEST))


def relative_planck(temperature: float, wavelengths: npt.ArrayLike) -> npt.NDArray[np.float64]:
    """Spectral radiance of a blackbody over that at 560 nm (Planck's law).

    Parameters
    ----------
    temperature : float  [K]
        Infinity gives the limit.
    wavelengths : float64 (N,)  [nm]

    Returns
    -------
    float64 (N,)
    """
    wavelengths = np.asarray(wavelengths, np.float64)
    if math.isinf(temperature):
        return (_REFERENCE / wavelengths) ** 4
    exponent = RADIATION_CONSTANT / temperature
    return (_REFERENCE / wavelengths) ** 5 * np.expm1(exponent / _REFERENCE) / np.expm1(exponent / wavelengths)


def blackbody_tables() -> tuple[npt.NDArray[np.float32], npt.NDArray[np.float32]]:
    """What kernels interpolate.

    Returns
    -------
    relative_d65 : float32 (WAVELENGTH_NODES,)
        D65 every 5 nm over that at 560 nm.
    blackbody_scale : float32 (TEMPERATURE_NODES,)
        Luminance of D65 over that of a blackbody, both 1 at 560 nm; even in 1 / temperature.
    """
    reference = float(d65(_REFERENCE))
    luminance = xyz_matching(GRID)[:, 1]
    inverse = np.arange(TEMPERATURE_NODES) / ((TEMPERATURE_NODES - 1) * LOWEST_TEMPERATURE)
    bodies = np.stack([relative_planck(1.0 / t if t > 0.0 else math.inf, GRID) for t in inverse])
    scale = integrate(d65(GRID) / reference * luminance, GRID) / integrate(bodies * luminance, GRID, axis=1)
    return (D65 / reference).astype(np.float32), scale.astype(np.float32)


@kernel
def blackbody_over_d65(tables, temperature, wavelength):
    """Radiance of a blackbody, scaled to luminance 1, over D65.

    Parameters
    ----------
    tables : SpectralTables
    temperature : float32  [K]
        Clamped to 500 K and 1e6 K; NaN is the lowest.
    wavelength : float32  [nm], 380 to 780

    Returns
    -------
    float32
        Relative to D65, for `rgb_weight`.
    """
    if not temperature > _LOWEST:
        temperature = _LOWEST
    inverse = 1.0 / min(temperature, _HIGHEST)
    position = inverse * _NODES_PER_KELVIN
    node = min(int(position), TEMPERATURE_NODES - 2)
    x = position - np.float32(node)
    scale = tables.blackbody_scale[node] * (1.0 - x) + tables.blackbody_scale[node + 1] * x

    position = max((wavelength - _SHORTEST) * _NODES_PER_NM, 0.0)
    node = min(int(position), WAVELENGTH_NODES - 2)
    x = position - np.float32(node)
    illuminant = tables.relative_d65[node] * (1.0 - x) + tables.relative_d65[node + 1] * x

    exponent = _RADIATION * inverse
    ratio = _REFERENCE_32 / wavelength
    ratio *= ratio * ratio * ratio * ratio * math.expm1(exponent / _REFERENCE_32) / math.expm1(exponent / wavelength)
    return scale * ratio / illuminant
