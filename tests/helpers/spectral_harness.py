# SPDX-License-Identifier: GPL-3.0-or-later
"""Kernels of `engine.spectral` over arrays."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from engine.runtime.jit import kernel
from engine.spectral.blackbody import blackbody_over_d65
from engine.spectral.dispersion import ior_at
from engine.spectral.tables import load_spectral_tables
from engine.spectral.upsampling import evaluate_spectrum, spectrum_coefficients
from engine.spectral.wavelengths import rgb_weight, rotate_hero, wavelength_at


@kernel
def _spectra(tables, colors, wavelengths, out):
    for i in range(colors.shape[0]):
        scale, c0, c1, c2 = spectrum_coefficients(tables, colors[i, 0], colors[i, 1], colors[i, 2])
        for k in range(wavelengths.shape[0]):
            out[i, k] = evaluate_spectrum(scale, c0, c1, c2, wavelengths[k])


@kernel
def _wavelengths(tables, u, index, out):
    for i in range(u.shape[0]):
        moved = rotate_hero(u[i], index) if index > 0 else u[i]
        r, g, b = rgb_weight(tables, moved)
        out[i, 0] = wavelength_at(tables, moved)
        out[i, 1] = r
        out[i, 2] = g
        out[i, 3] = b


@kernel
def _blackbodies(tables, temperatures, wavelengths, out):
    for i in range(temperatures.shape[0]):
        for k in range(wavelengths.shape[0]):
            out[i, k] = blackbody_over_d65(tables, temperatures[i], wavelengths[k])


@kernel
def _iors(ior_d, dispersion, wavelengths, out):
    for k in range(wavelengths.shape[0]):
        out[k] = ior_at(ior_d, dispersion, wavelengths[k])


def spectra(colors: npt.ArrayLike, wavelengths: npt.ArrayLike) -> npt.NDArray[np.float32]:
    """Spectra (N, K) of linear Rec.709 colours (N, 3) at wavelengths (K,) [nm]."""
    colors, wavelengths = np.asarray(colors, np.float32), np.asarray(wavelengths, np.float32)
    out = np.empty((len(colors), len(wavelengths)), np.float32)
    _spectra(load_spectral_tables(), colors, wavelengths, out)
    return out


def wavelengths_and_weights(u: npt.ArrayLike, index: int = 0) -> npt.NDArray[np.float32]:
    """Wavelength [nm] and its weights, (N, 4), of the number of a path's wavelength `index` whose hero's is u (N,)."""
    u = np.asarray(u, np.float32)
    out = np.empty((len(u), 4), np.float32)
    _wavelengths(load_spectral_tables(), u, np.int64(index), out)
    return out


def blackbodies(temperatures: npt.ArrayLike, wavelengths: npt.ArrayLike) -> npt.NDArray[np.float32]:
    """Spectra (N, K) of blackbodies (N,) [K] over D65 at wavelengths (K,) [nm]."""
    temperatures, wavelengths = np.asarray(temperatures, np.float32), np.asarray(wavelengths, np.float32)
    out = np.empty((len(temperatures), len(wavelengths)), np.float32)
    _blackbodies(load_spectral_tables(), temperatures, wavelengths, out)
    return out


def iors(ior_d: float, dispersion: float, wavelengths: npt.ArrayLike) -> npt.NDArray[np.float32]:
    """Refractive indices (K,) at wavelengths [nm]."""
    wavelengths = np.asarray(wavelengths, np.float32)
    out = np.empty(len(wavelengths), np.float32)
    _iors(np.float32(ior_d), np.float32(dispersion), wavelengths, out)
    return out
