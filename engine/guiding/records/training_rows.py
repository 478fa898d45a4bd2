# SPDX-License-Identifier: GPL-3.0-or-later
"""What a guiding network learns from: one row of plain numbers for each scattering."""

from __future__ import annotations

import numpy as np

from engine.array_types import Float32Array
from engine.kernels.rng import hash_combine
from engine.runtime.jit import kernel
from engine.state.columns import RowLayout

# Columns of a row. Vectors are unit and in world space.
_row = RowLayout()
ROW_POSITION = _row.take(3)  #: [m]
ROW_WI = _row.take(3)
ROW_WO = _row.take(3)
ROW_NORMAL = _row.take(3)  #: shading normal on the viewer's side
ROW_ROUGHNESS = _row.take()  #: in [0, 1]
ROW_RADIANCE = _row.take()  #: mean over channels of an estimate of the incident radiance along wi
ROW_REFLECTANCE = _row.take()  #: mean over channels of BSDF * |cos| at wi [sr^-1]
ROW_PDF = _row.take()  #: density that wi was drawn with [sr^-1]
ROW_BSDF_PDF = _row.take()  #: density of the BSDF's own sampling at wi [sr^-1]
ROW_GUIDE_PDF = _row.take()  #: density of the guide at wi [sr^-1]; 0 where nothing was guided
ROW_U = _row.take()  #: in [0, 1], of the shutter or of the wavelengths, see `settings.U_DIMENSIONS`
ROW_WIDTH = _row.width()

#: u at the shutter's opening and closing, where it is the time of the shutter and nothing else.
SHUTTER_SPAN = (0.0, 1.0)

_SCALARS = {
    "roughness": ROW_ROUGHNESS,
    "radiance": ROW_RADIANCE,
    "reflectance": ROW_REFLECTANCE,
    "pdf": ROW_PDF,
    "bsdf_pdf": ROW_BSDF_PDF,
    "guide_pdf": ROW_GUIDE_PDF,
    "u": ROW_U,
}


def is_fit(rows: Float32Array) -> np.ndarray:
    """Which rows can be learned from: all finite, drawn with some density, and no light or density below zero.

    Parameters
    ----------
    rows : float32 (N, ROW_WIDTH)

    Returns
    -------
    bool (N,)
    """
    # A sum of finite float32 in float64 cannot overflow, and NaN and infinity survive it.
    is_finite = np.isfinite(rows.sum(axis=1, dtype=np.float64))
    return is_finite & (rows[:, ROW_PDF] > 0.0) & (rows[:, ROW_RADIANCE:ROW_U] >= 0.0).all(axis=1)


def make_rows(
    position: Float32Array, wi: Float32Array, wo: Float32Array, normal: Float32Array, **scalars: Float32Array | float
) -> Float32Array:
    """Rows of arrays, without those that cannot be learned from (`is_fit`).

    Parameters
    ----------
    position, wi, wo, normal : float32 (N, 3)
    **scalars : float32 (N,) or float
        roughness, radiance, reflectance, pdf, bsdf_pdf, guide_pdf, u, as ROW_*; 0 where left out.

    Returns
    -------
    float32 (at most N, ROW_WIDTH)
    """
    rows = np.zeros((position.shape[0], ROW_WIDTH), np.float32)
    # What does not fit into a float32 becomes infinite, and is left out.
    with np.errstate(over="ignore", invalid="ignore"):
        for column, vectors in ((ROW_POSITION, position), (ROW_WI, wi), (ROW_WO, wo), (ROW_NORMAL, normal)):
            rows[:, column : column + 3] = vectors
        for name, values in scalars.items():
            rows[:, _SCALARS[name]] = values
        return rows[is_fit(rows)]


@kernel
def pick_row(k, row_count, taken_count, seed):
    """A row drawn from the `k`-th of `taken_count` equal stretches of `row_count` rows: int."""
    low = k * row_count // taken_count
    stretch = (k + 1) * row_count // taken_count - low
    row = low
    if stretch > 1:
        row = low + np.int64(hash_combine(np.uint32(seed), np.uint32(k))) % stretch
    return row


@kernel
def pack_training_rows(rows, row_count, taken_count, seed, out):
    """Pick rows at random, one from each of `taken_count` equal stretches; leave out those not fit to learn from.

    Parameters
    ----------
    rows : float32 (N, W)
    row_count : int, rows in use
    taken_count : int, at most `row_count`
    seed : uint32
    out : float32 (at least taken_count, W), written

    Returns
    -------
    int
        Rows written; `taken_count` less the rejected ones.
    """
    written = 0
    for k in range(taken_count):
        row = pick_row(k, row_count, taken_count, seed)
        # Comparisons are false for NaN.
        is_good = rows[row, ROW_PDF] > 0.0
        for column in range(rows.shape[1]):
            value = rows[row, column]
            out[written, column] = value
            is_good &= abs(value) < np.float32(np.inf)
            is_good &= value >= 0.0 or column < ROW_RADIANCE
        if is_good:
            written += 1
    return written
