# SPDX-License-Identifier: GPL-3.0-or-later
"""Everything that spectral kernels look up."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
import numpy.typing as npt

from engine.runtime.bundle import Bundle
from engine.spectral.blackbody import blackbody_tables
from engine.spectral.observer import XYZ_TO_REC709
from engine.spectral.upsampling import TABLE_SHAPE
from engine.spectral.wavelengths import wavelength_tables

COEFFICIENTS_FILE = Path(__file__).with_name("coefficients.npz")

Float32Array = npt.NDArray[np.float32]


class SpectralTables(Bundle):
    """Tables of `engine.spectral`.

    wavelengths : float32 (CELL_COUNT + 1,)  [nm], over u (`engine.spectral.wavelengths`)
    rgb_weights : float32 (CELL_COUNT + 1, 3), over u
    coefficients : float32, the numbers of `upsampling.TABLE_SHAPE` in a row
    relative_d65 : float32 (WAVELENGTH_NODES,), D65 over its value at 560 nm (`engine.spectral.blackbody`)
    blackbody_scale : float32 (TEMPERATURE_NODES,), over 1 / temperature
    to_rec709 : float32 (3, 3), what colours are multiplied by before; (0, 3) where they are Rec.709
    """

    wavelengths: Float32Array
    rgb_weights: Float32Array
    coefficients: Float32Array
    relative_d65: Float32Array
    blackbody_scale: Float32Array
    to_rec709: Float32Array


@cache
def load_spectral_tables() -> SpectralTables:
    """The tables: coefficients from the file shipped with the package, the rest computed (milliseconds)."""
    with np.load(COEFFICIENTS_FILE) as stored:
        coefficients = stored["coefficients"].astype(np.float32).reshape(TABLE_SHAPE)
    no_matrix = np.zeros((0, 3), np.float32)
    return SpectralTables(*wavelength_tables(), coefficients.ravel(), *blackbody_tables(), no_matrix)


def tables_for(to_xyz: Float32Array | None) -> SpectralTables:
    """The tables for a working space: what the film gets is in it, and colours are, that spectra are looked up for.

    Parameters
    ----------
    to_xyz : float32 (3, 3) or None
        From the working space to XYZ; None: it is Rec.709.
    """
    tables = load_spectral_tables()
    if to_xyz is None:
        return tables
    to_rec709 = XYZ_TO_REC709.astype(np.float64) @ to_xyz.astype(np.float64)
    weights = tables.rgb_weights.astype(np.float64) @ np.linalg.inv(to_rec709).T
    return tables._replace(rgb_weights=weights.astype(np.float32), to_rec709=to_rec709.astype(np.float32))


def no_spectral_tables() -> SpectralTables:
    """Stand-in for renders in RGB, which look nothing up."""
    nothing = np.zeros(1, np.float32)
    rows = np.zeros((1, 3), np.float32)
    return SpectralTables(nothing, rows, nothing, nothing, nothing, rows)
