# SPDX-License-Identifier: GPL-3.0-or-later
"""The CIE 1931 observer and D65, and linear Rec.709 of a spectrum.

Spectra are relative to D65: the constant 1 is a white reflectance, and a white lamp. A channel of Rec.709 is the
integral of the spectrum times a response, which is D65 times the channel's matching function and integrates to 1, so
that the constant 1 is (1, 1, 1). Responses are normalised one by one: tables of 4 digits miss the matrix' white by
0.1 %.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]

#: Integral by trapezia, under numpy's name of it: another since numpy 2.
integrate = np.trapezoid if hasattr(np, "trapezoid") else np.trapz  # type: ignore[attr-defined]

#: Range of the spectrum [nm].
SHORTEST = 380.0
LONGEST = 780.0

#: CIE 1931 2 degree observer, x y z every 5 nm from 380 to 780 nm.
CIE_1931 = np.array(
    (
        (0.0014, 0.0000, 0.0065), (0.0022, 0.0001, 0.0105), (0.0042, 0.0001, 0.0201),
        (0.0076, 0.0002, 0.0362), (0.0143, 0.0004, 0.0679), (0.0232, 0.0006, 0.1102),
        (0.0435, 0.0012, 0.2074), (0.0776, 0.0022, 0.3713), (0.1344, 0.0040, 0.6456),
        (0.2148, 0.0073, 1.0391), (0.2839, 0.0116, 1.3856), (0.3285, 0.0168, 1.6230),
        (0.3483, 0.0230, 1.7471), (0.3481, 0.0298, 1.7826), (0.3362, 0.0380, 1.7721),
        (0.3187, 0.0480, 1.7441), (0.2908, 0.0600, 1.6692), (0.2511, 0.0739, 1.5281),
        (0.1954, 0.0910, 1.2876), (0.1421, 0.1126, 1.0419), (0.0956, 0.1390, 0.8130),
        (0.0580, 0.1693, 0.6162), (0.0320, 0.2080, 0.4652), (0.0147, 0.2586, 0.3533),
        (0.0049, 0.3230, 0.2720), (0.0024, 0.4073, 0.2123), (0.0093, 0.5030, 0.1582),
        (0.0291, 0.6082, 0.1117), (0.0633, 0.7100, 0.0782), (0.1096, 0.7932, 0.0573),
        (0.1655, 0.8620, 0.0422), (0.2257, 0.9149, 0.0298), (0.2904, 0.9540, 0.0203),
        (0.3597, 0.9803, 0.0134), (0.4334, 0.9950, 0.0087), (0.5121, 1.0000, 0.0057),
        (0.5945, 0.9950, 0.0039), (0.6784, 0.9786, 0.0027), (0.7621, 0.9520, 0.0021),
        (0.8425, 0.9154, 0.0018), (0.9163, 0.8700, 0.0017), (0.9786, 0.8163, 0.0014),
        (1.0263, 0.7570, 0.0011), (1.0567, 0.6949, 0.0010), (1.0622, 0.6310, 0.0008),
        (1.0456, 0.5668, 0.0006), (1.0026, 0.5030, 0.0003), (0.9384, 0.4412, 0.0002),
        (0.8544, 0.3810, 0.0002), (0.7514, 0.3210, 0.0001), (0.6424, 0.2650, 0.0000),
        (0.5419, 0.2170, 0.0000), (0.4479, 0.1750, 0.0000), (0.3608, 0.1382, 0.0000),
        (0.2835, 0.1070, 0.0000), (0.2187, 0.0816, 0.0000), (0.1649, 0.0610, 0.0000),
        (0.1212, 0.0446, 0.0000), (0.0874, 0.0320, 0.0000), (0.0636, 0.0232, 0.0000),
        (0.0468, 0.0170, 0.0000), (0.0329, 0.0119, 0.0000), (0.0227, 0.0082, 0.0000),
        (0.0158, 0.0057, 0.0000), (0.0114, 0.0041, 0.0000), (0.0081, 0.0029, 0.0000),
        (0.0058, 0.0021, 0.0000), (0.0041, 0.0015, 0.0000), (0.0029, 0.0010, 0.0000),
        (0.0020, 0.0007, 0.0000), (0.0014, 0.0005, 0.0000), (0.0010, 0.0004, 0.0000),
        (0.0007, 0.0002, 0.0000), (0.0005, 0.0002, 0.0000), (0.0003, 0.0001, 0.0000),
        (0.0002, 0.0001, 0.0000), (0.0002, 0.0001, 0.0000), (0.0001, 0.0000, 0.0000),
        (0.0001, 0.0000, 0.0000), (0.0001, 0.0000, 0.0000), (0.0000, 0.0000, 0.0000),
    ),
    np.float32,
)  # fmt: skip

#: CIE standard illuminant D65, relative power at the same wavelengths (CIE 15, 5 nm steps).
D65 = np.array(
    (
        49.9755, 52.3118, 54.6482, 68.7015, 82.7549, 87.1204, 91.4860, 92.4589, 93.4318,
        90.0570, 86.6823, 95.7736, 104.8650, 110.9360, 117.0080, 117.4100, 117.8120, 116.3360,
        114.8610, 115.3920, 115.9230, 112.3670, 108.8110, 109.0820, 109.3540, 108.5780, 107.8020,
        106.2960, 104.7900, 106.2390, 107.6890, 106.0470, 104.4050, 104.2250, 104.0460, 102.0230,
        100.0000, 98.1671, 96.3342, 96.0611, 95.7880, 92.2368, 88.6856, 89.3459, 90.0062,
        89.8026, 89.5991, 88.6489, 87.6987, 85.4936, 83.2886, 83.4939, 83.6992, 81.8630,
        80.0268, 80.1207, 80.2146, 81.2462, 82.2778, 80.2810, 78.2842, 74.0027, 69.7213,
        70.6652, 71.6091, 72.9790, 74.3490, 67.9765, 61.6040, 65.7448, 69.8856, 72.4863,
        75.0870, 69.3398, 63.5927, 55.0054, 46.4182, 56.6118, 66.8054, 65.0941, 63.3828,
    ),
    np.float32,
)  # fmt: skip

XYZ_TO_REC709 = np.array(
    ((3.2409699, -1.5373832, -0.4986108), (-0.9692436, 1.8759675, 0.0415551), (0.0556301, -0.2039770, 1.0569715)),
    np.float32,
)

#: The same as linear Rec.709, scaled as Cycles does so that no component exceeds about 1; not clamped.
CIE_1931_TO_REC709 = (CIE_1931 @ XYZ_TO_REC709.T / np.float32(2.52)).astype(np.float32)


#: Wavelengths of the tables, and those at which we integrate [nm].
TABLE_WAVELENGTHS = np.linspace(SHORTEST, LONGEST, len(CIE_1931))
GRID = np.linspace(SHORTEST, LONGEST, 401)


def d65(wavelengths: FloatArray | float) -> FloatArray:
    """D65 between the entries of its table.

    Parameters
    ----------
    wavelengths : float64 (...)  [nm]

    Returns
    -------
    float64 (...), relative power, 100 at 560 nm
    """
    return np.asarray(np.interp(wavelengths, TABLE_WAVELENGTHS, D65.astype(np.float64)))


def xyz_matching(wavelengths: FloatArray) -> FloatArray:
    """The observer's matching functions between the entries of their table.

    Parameters
    ----------
    wavelengths : float64 (N,)  [nm]

    Returns
    -------
    float64 (N, 3), x y z
    """
    return np.stack([np.interp(wavelengths, TABLE_WAVELENGTHS, column) for column in CIE_1931.T], axis=-1)


def _unscaled_responses(wavelengths: FloatArray) -> FloatArray:
    return d65(wavelengths)[:, None] * (xyz_matching(wavelengths) @ XYZ_TO_REC709.T.astype(np.float64))


_WHITE = integrate(_unscaled_responses(GRID), GRID, axis=0)


def rec709_responses(wavelengths: FloatArray) -> FloatArray:
    """What linear Rec.709 gets of each wavelength of a spectrum relative to D65.

    Parameters
    ----------
    wavelengths : float64 (N,)  [nm]

    Returns
    -------
    float64 (N, 3)  [1/nm]
        Integrals over the range are 1; partly negative.
    """
    return _unscaled_responses(wavelengths) / _WHITE


#: The responses at `GRID` times the trapezoidal rule's weights; columns sum to 1.
RESPONSES = rec709_responses(GRID) * np.where((GRID == SHORTEST) | (GRID == LONGEST), 0.5, 1.0)[:, None]


def spectrum_to_rec709(spectrum: npt.ArrayLike) -> FloatArray:
    """Linear Rec.709 of spectra relative to D65.

    Parameters
    ----------
    spectrum : float64 (..., 401)
        Values at `GRID`.

    Returns
    -------
    float64 (..., 3)
    """
    return np.asarray(spectrum, np.float64) @ RESPONSES
