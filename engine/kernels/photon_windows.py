# SPDX-License-Identifier: GPL-3.0-or-later
"""Photons of other times and wavelengths than a path's: which it gathers, and what their power is to it.

What is gathered in a window about the path's own number x in [0, 1], from numbers y that are uniform there, is weighed
by a box that is mirrored at the ends. Its integral over y is that over x: every path finds all, and no photon is lost.

References: Silverman 1986, "Density Estimation for Statistics and Data Analysis", section 2.10: reflection.
"""

import math

import numpy as np

from engine.runtime.jit import kernel
from engine.spectral.wavelengths import rotate_hero
from engine.state.photons import PHOTON_HERO, PHOTON_POWERS


@kernel
def window_weight(x, y, half):
    """How often a number is within a window about another one, itself or mirrored at 0 or 1: the box, times 2 `half`.

    Parameters
    ----------
    x, y : float32 in [0, 1]
    half : float32, at most 1/2
    """
    weight = np.float32(0.0)
    if abs(x - y) < half:
        weight += np.float32(1.0)
    if x + y < half:
        weight += np.float32(1.0)
    if np.float32(2.0) - x - y < half:
        weight += np.float32(1.0)
    return weight


@kernel
def part_of_time(time, half):
    """Which part of the shutter a time is in, each as long as a window: those of a window are two at most."""
    return np.int64(math.floor(time / (half + half))) if half > 0.0 else np.int64(0)


@kernel
def parts_of_times(times, half, parts):
    """Write `part_of_time` of each."""
    for row in range(times.shape[0]):
        parts[row] = part_of_time(times[row], half)


@kernel
def power_of_channel(photons, row, hero, c, half):
    """What a photon brings to a path at the path's wavelength `c` [W].

    Both have wavelengths at equal steps of [0, 1): at most one of the photon's is near enough.

    Parameters
    ----------
    photons : float32 (P, PHOTON_WIDTH_MORE)
    hero : float32 in [0, 1), the path's
    half : float32, at most 1/8: of the window
    """
    x = rotate_hero(hero, c)
    steps = np.float32(4.0) * (x - photons[row, PHOTON_HERO])
    k = np.int64(math.floor(steps + np.float32(0.5))) & 3
    weight = window_weight(x, rotate_hero(photons[row, PHOTON_HERO], k), half)
    return weight * photons[row, PHOTON_POWERS + k]
