# SPDX-License-Identifier: GPL-3.0-or-later
"""Thin films: light that is reflected at both of their sides interferes.

In RGB a series over the times that light crosses the film, whose terms are integrals over the colours' responses, up to
the third as in Cycles. At a wavelength the whole series has a closed form (Airy's).

References: Belcour and Barla 2017, "A Practical Extension to Microfacet Theory for the Modeling of Varying
Iridescence", Eqs. 6 to 10.
"""

import math

import numpy as np

from engine.array_types import Float32Array
from engine.kernels.addresses import read_real
from engine.kernels.bsdf.conductor import (
    conductor_phases,
    conductor_reflectances,
    f82_b_of_value,
    f82_curve,
)
from engine.kernels.bsdf.linked import FILM_TABLE
from engine.kernels.constants import TWO_PI
from engine.kernels.rounding import floor_of
from engine.runtime.jit import kernel
from engine.spectral.observer import GRID, XYZ_TO_REC709, xyz_matching

#: What thicker films count as, so that no number overflows [nm]. They have no colour left.
MOST_THICKNESS = np.float32(1e9)
#: Columns of the table, over paths up to `_LONGEST_PATH`.
TABLE_SIZE = 512
#: [nm]
_LONGEST_PATH = np.float32(60000.0 / (2.0 * math.pi))
#: Of no wavelength: a channel of RGB.
NO_WAVE = np.float32(0.0)


def film_table(to_xyz: Float32Array | None) -> Float32Array:
    """Fourier transform of the responses of red, green and blue, over the difference between two ways of light.

    Parameters
    ----------
    to_xyz : float32 (3, 3) or None
        From the scene's working space, Rec.709 if None.

    Returns
    -------
    float32 (6, TABLE_SIZE)
        Cosine transforms of the three, then sine transforms, negative; 1 and 0 without a difference.
    """
    from_xyz = XYZ_TO_REC709.astype(np.float64) if to_xyz is None else np.linalg.inv(to_xyz.astype(np.float64))
    fine = np.linspace(GRID[0], GRID[-1], 4 * (len(GRID) - 1) + 1)
    responses = xyz_matching(fine) @ from_xyz.T
    phases = 2.0 * np.pi * np.linspace(0.0, float(_LONGEST_PATH), TABLE_SIZE)[:, None] / fine
    table = np.concatenate([np.cos(phases) @ responses, -np.sin(phases) @ responses], axis=1) / np.tile(
        responses.sum(axis=0), 2
    )
    # Beyond, where all is looked up in the last column, colours are as good as gone.
    table[-1, 3:] = 0.0
    return np.ascontiguousarray(table.T, np.float32)


@kernel
def _sensitivity(block, row, path):
    """One entry of the table, between its columns."""
    x = min(max(path / _LONGEST_PATH, 0.0), 1.0) * np.float32(TABLE_SIZE - 1)
    column = min(int(x), TABLE_SIZE - 2)
    x -= np.float32(column)
    at = 8 * FILM_TABLE + 4 * (row * TABLE_SIZE + column)
    return read_real(block, at) * (1.0 - x) + read_real(block, at + 4) * x


@kernel
def _interfere(block, c, wavelength, r12, r23, path, re, im):
    """Reflectance of one polarisation.

    Parameters
    ----------
    r12, r23 : float32
        Reflectances of the film's sides.
    path : float32 [nm]
        Difference between the ways of light that is reflected at either side.
    re, im : float32
        exp(i phi) of the phase shifts at the sides.
    """
    through = 1.0 - r12
    both = min(r12 * r23, 0.999999)
    amplitude = math.sqrt(both)
    back = through * through * r23 / (1.0 - both)
    total = back + r12
    factor = back - through
    if wavelength != NO_WAVE:
        # Sum over m of 2 a^m cos(m phi).
        turns = path / wavelength
        angle = TWO_PI * (turns - np.float32(floor_of(turns)))
        cosine = re * math.cos(angle) - im * math.sin(angle)
        return total + factor * 2.0 * (amplitude * cosine - both) / (1.0 - 2.0 * amplitude * cosine + both)
    re_m, im_m = re, im
    for m in range(1, 4):
        factor *= amplitude
        way = np.float32(m) * path
        total += factor * 2.0 * (re_m * _sensitivity(block, c, way) + im_m * _sensitivity(block, c + 3, way))
        re_m, im_m = re_m * re - im_m * im, re_m * im + im_m * re
    return total


@kernel
def _polarised(cos_i, eta):
    """Reflectances of a dielectric's s and p polarisation, signs of their amplitudes, and the refracted cosine.

    Total reflection has a cosine of 0.
    """
    squared = eta * eta - 1.0 + cos_i * cos_i
    if squared <= 0.0:
        return np.float32(1.0), np.float32(1.0), np.float32(1.0), np.float32(1.0), np.float32(0.0)
    eta_cos_t = math.sqrt(squared)
    r_s = (cos_i - eta_cos_t) / max(cos_i + eta_cos_t, 1e-20)
    r_p = (eta * eta * cos_i - eta_cos_t) / max(eta * eta * cos_i + eta_cos_t, 1e-20)
    sign_s = 1.0 if r_s >= 0.0 else -1.0
    sign_p = 1.0 if r_p >= 0.0 else -1.0
    return r_s * r_s, r_p * r_p, sign_s, sign_p, eta_cos_t / eta


@kernel
def film_reflectance(block, c, wavelength, cosine, thickness, film_ior, n, k, f82):
    """Reflectance of a surface below a film.

    Parameters
    ----------
    block : int, address of `BsdfTables.linked`
    c : int, channel
    wavelength : float32 [nm], `NO_WAVE` in RGB
    cosine : float32, of the viewer with the facet
    thickness : float32 [nm]
    film_ior, n, k : float32
        Refractive indices over that outside; k is below 0 for a dielectric.
    f82 : float32
        A metal's reflectance at 82 degrees, by which its curve goes, below 0: it goes by n and k.
    """
    if thickness < 1.0:
        blend = max(thickness, 0.0)
        film_ior = 1.0 + (film_ior - 1.0) * blend * blend * (3.0 - 2.0 * blend)
    r12_s, r12_p, sign_s, sign_p, cos_2 = _polarised(abs(cosine), film_ior)
    if cos_2 == 0.0:
        return np.float32(1.0)
    if k < 0.0:
        r23_s, r23_p, re_s, re_p, cos_3 = _polarised(cos_2, n / film_ior)
        im_s, im_p = np.float32(0.0), np.float32(0.0)
        if cos_3 == 0.0:
            return np.float32(1.0)
    else:
        r23_s, r23_p = conductor_reflectances(cos_2, film_ior, n, k)
        if f82 >= 0.0:
            inside, inside_k = n / film_ior, k / film_ior
            f0 = (inside - 1.0) * (inside - 1.0) + inside_k * inside_k
            f0 /= (inside + 1.0) * (inside + 1.0) + inside_k * inside_k
            r23_s = f82_curve(f0, f82_b_of_value(f0, f82), cos_2)
            r23_p = r23_s
        re_s, im_s, re_p, im_p = conductor_phases(cos_2, film_ior, n, k)
    path = 2.0 * film_ior * min(thickness, MOST_THICKNESS) * cos_2
    r_s = _interfere(block, c, wavelength, r12_s, r23_s, path, -sign_s * re_s, -sign_s * im_s)
    r_p = _interfere(block, c, wavelength, r12_p, r23_p, path, -sign_p * re_p, -sign_p * im_p)
    return min(max(0.5 * (r_s + r_p), 0.0), 1.0)
