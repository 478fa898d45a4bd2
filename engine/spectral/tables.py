# SPDX-License-Identifier: GPL-3.0-or-later
"""Everything that spectral kernels look up."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
import numpy.typing as npt

from engine.bundle import Bundle
from engine.spectral.blackbody import blackbody_tables
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
    """

    wavelengths: Float32Array
    rgb_weights: Float32Array
    coefficients: Float32Array
    relative_d65: Float32Array
    blackbody_scale: Float32Array


@cache
def load_spectral_tables() -> SpectralTables:
    """The tables: coefficients from the file shipped with the package, the rest computed (milliseconds)."""
    with np.load(COEFFICIENTS_FILE) as stored:
        coefficients = stored["coefficients"].astype(np.float32).reshape(TABLE_SHAPE)
    return SpectralTables(*wavelength_tables(), coefficients.ravel(), *blackbody_tables())
