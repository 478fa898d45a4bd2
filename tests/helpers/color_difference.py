# SPDX-License-Identifier: GPL-3.0-or-later
"""CIELAB and Delta E 2000 (Sharma, Wu and Dalal 2005)."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]

_REC709_TO_XYZ = np.array(
    ((0.4123908, 0.3575843, 0.1804808), (0.2126390, 0.7151687, 0.0721923), (0.0193308, 0.1191948, 0.9505322))
)


def lab_of_rec709(rgb: npt.ArrayLike) -> FloatArray:
    """CIELAB (..., 3), relative to D65, of linear Rec.709."""
    xyz = np.asarray(rgb, np.float64) @ _REC709_TO_XYZ.T / _REC709_TO_XYZ.sum(axis=1)
    bend = 6.0 / 29.0
    f = np.where(xyz > bend**3, np.cbrt(np.maximum(xyz, bend**3)), xyz / (3.0 * bend**2) + 4.0 / 29.0)
    x, y, z = np.moveaxis(f, -1, 0)
    return np.stack([116.0 * y - 16.0, 500.0 * (x - y), 200.0 * (y - z)], axis=-1)


def delta_e_2000(first: FloatArray, second: FloatArray) -> FloatArray:
    """Colour differences (...) of CIELAB (..., 3)."""
    l1, a1, b1 = np.moveaxis(first, -1, 0)
    l2, a2, b2 = np.moveaxis(second, -1, 0)
    mean_chroma = 0.5 * (np.hypot(a1, b1) + np.hypot(a2, b2))
    stretch = 1.5 - 0.5 * np.sqrt(mean_chroma**7 / (mean_chroma**7 + 25.0**7))
    a1, a2 = a1 * stretch, a2 * stretch
    c1, c2 = np.hypot(a1, b1), np.hypot(a2, b2)
    h1, h2 = (np.degrees(np.arctan2(b, a)) % 360.0 for b, a in ((b1, a1), (b2, a2)))
    is_grey = c1 * c2 == 0.0
    turn = h2 - h1
    turn = np.where(turn > 180.0, turn - 360.0, np.where(turn < -180.0, turn + 360.0, turn))
    turn = np.where(is_grey, 0.0, turn)
    hue = 2.0 * np.sqrt(c1 * c2) * np.sin(np.radians(0.5 * turn))
    lightness, chroma = 0.5 * (l1 + l2), 0.5 * (c1 + c2)
    total = h1 + h2
    across = np.where(total < 360.0, 0.5 * (total + 360.0), 0.5 * (total - 360.0))
    mean_hue = np.where(is_grey, total, np.where(np.abs(h1 - h2) <= 180.0, 0.5 * total, across))
    t = 1.0 - 0.17 * np.cos(np.radians(mean_hue - 30.0)) + 0.24 * np.cos(np.radians(2.0 * mean_hue))
    t += 0.32 * np.cos(np.radians(3.0 * mean_hue + 6.0)) - 0.20 * np.cos(np.radians(4.0 * mean_hue - 63.0))
    s_l = 1.0 + 0.015 * (lightness - 50.0) ** 2 / np.sqrt(20.0 + (lightness - 50.0) ** 2)
    s_c, s_h = 1.0 + 0.045 * chroma, 1.0 + 0.015 * chroma * t
    rotation = -2.0 * np.sqrt(chroma**7 / (chroma**7 + 25.0**7))
    rotation = rotation * np.sin(np.radians(60.0 * np.exp(-(((mean_hue - 275.0) / 25.0) ** 2))))
    by_lightness, by_chroma, by_hue = (l2 - l1) / s_l, (c2 - c1) / s_c, hue / s_h
    return np.sqrt(by_lightness**2 + by_chroma**2 + by_hue**2 + rotation * by_chroma * by_hue)
