# SPDX-License-Identifier: GPL-3.0-or-later
"""Gabor noise: waves of one frequency in small windows that are strewn over the cells of a grid.

The windows' waves are summed as phasors, so that a sum has a phase and an intensity beside its value.

References: Lagae, Lefebvre, Drettakis and Dutre 2009, "Procedural Noise using Sparse Gabor Convolution"; Tavernier et
al. 2019, "Making Gabor Noise Fast and Normalized"; Tricard et al. 2019, "Procedural Phasor Noise".
"""

import math

import numpy as np

from engine.kernels.constants import INV_TWO_PI, PI, TWO_PI
from engine.kernels.limits import clamp_unit
from engine.kernels.rounding import floor_of
from engine.kernels.shader.procedural_hash import unit_3, unit_4
from engine.kernels.vector import dot, length, scale
from engine.runtime.jit import kernel

#: Windows in each cell.
_WINDOWS = 8
_LEAST_FREQUENCY = np.float32(0.001)
#: Six standard deviations of a sum of waves, whose signs are random: values are then within -1 and 1 but for few.
_RANGE_2D = np.float32(6.0 * math.sqrt(_WINDOWS * 0.5 * 0.25))
_RANGE_3D = np.float32(6.0 * math.sqrt(_WINDOWS * 0.5 / (4.0 * math.sqrt(2.0))))


@kernel
def _wave(squared_distance, cycles, sign):
    """A wave that has gone through so many cycles, in a Gaussian within a Hann window of radius 1."""
    hann = 0.5 + 0.5 * math.cos(PI * squared_distance)
    weight = sign * (math.exp(-PI * squared_distance) * hann)
    angle = TWO_PI * cycles
    return weight * math.cos(angle), weight * math.sin(angle)


@kernel
def _gabor_2d(x, y, frequency, isotropy, orientation):
    """Phasor at a point of the plane."""
    left, bottom = np.float32(floor_of(x)), np.float32(floor_of(y))
    real, imaginary = np.float32(0.0), np.float32(0.0)
    for row in range(-1, 2):
        for column in range(-1, 2):
            i, j = left + np.float32(column), bottom + np.float32(row)
            for window in range(_WINDOWS):
                seed = np.float32(3 * window + 1)
                u = (x - left) - np.float32(column) - unit_3(i, j, seed)
                v = (y - bottom) - np.float32(row) - unit_3(seed, i, j)
                squared = u * u + v * v
                if squared >= 1.0:
                    continue
                sign = np.float32(-1.0) if unit_3(i, j, np.float32(3 * window + 2)) < 0.5 else np.float32(1.0)
                turn = (unit_3(i, j, np.float32(3 * window)) - 0.5) * PI
                angle = orientation + turn * isotropy
                wave = _wave(squared, u * (frequency * math.cos(angle)) + v * (frequency * math.sin(angle)), sign)
                real += wave[0]
                imaginary += wave[1]
    return real, imaginary


@kernel
def _turned(orientation, isotropy, first, second):
    """A direction, turned away from its pole and about it by up to half a turn each."""
    if isotropy == 0.0:
        return orientation
    x, y, z = orientation
    inclination = math.acos(z) + first * PI * isotropy
    azimuth = math.acos(x / math.sqrt(x * x + y * y))
    if y < 0.0:
        azimuth = -azimuth
    azimuth += second * PI * isotropy
    across = math.sin(inclination)
    return across * math.cos(azimuth), across * math.sin(azimuth), math.cos(inclination)


@kernel
def _gabor_3d(p, frequency, isotropy, orientation):
    """Phasor at a point in space. The orientation is a unit vector."""
    low = np.float32(floor_of(p[0])), np.float32(floor_of(p[1])), np.float32(floor_of(p[2]))
    real, imaginary = np.float32(0.0), np.float32(0.0)
    for cell in range(27):
        a, b, c = np.float32(cell % 3 - 1), np.float32(cell // 3 % 3 - 1), np.float32(cell // 9 - 1)
        i, j, k = low[0] + a, low[1] + b, low[2] + c
        for window in range(_WINDOWS):
            seed = np.float32(3 * window + 1)
            u = (p[0] - low[0]) - a - unit_4(i, j, k, seed)
            v = (p[1] - low[1]) - b - unit_4(k, i, seed, j)
            w = (p[2] - low[2]) - c - unit_4(seed, k, j, i)
            squared = u * u + v * v + w * w
            if squared >= 1.0:
                continue
            sign = np.float32(-1.0) if unit_4(i, j, k, np.float32(3 * window + 2)) < 0.5 else np.float32(1.0)
            seed = np.float32(3 * window)
            along = _turned(orientation, isotropy, unit_4(i, j, k, seed), unit_4(k, i, seed, j))
            wave = _wave(squared, dot((u, v, w), scale(along, frequency)), sign)
            real += wave[0]
            imaginary += wave[1]
    return real, imaginary


@kernel
def gabor(p, is_solid, frequency, anisotropy, angle, direction):
    """Blender's Gabor texture at a scaled position.

    Parameters
    ----------
    p : tuple of 3 float32
    is_solid : bool
        Whether waves run through space, along `direction`. They run over the plane, at an angle to x, if not.
    frequency : float32, cycles a unit
    anisotropy : float32, 1 = all waves run the same way, 0 = any way
    angle : float32 [radians]
    direction : tuple of 3 float32

    Returns
    -------
    value, phase, intensity : float32
        All from 0 to 1, the value but for a few.
    """
    isotropy = 1.0 - clamp_unit(anisotropy)
    frequency = max(frequency, _LEAST_FREQUENCY)
    span = _RANGE_2D
    if is_solid:
        span = _RANGE_3D
        size = length(direction)
        # Divided, not multiplied by the inverse: what is nearly 1 goes through an arc cosine.
        along = direction[0] / size, direction[1] / size, direction[2] / size
        real, imaginary = _gabor_3d(p, frequency, isotropy, along)
    else:
        real, imaginary = _gabor_2d(p[0], p[1], frequency, isotropy, angle)
    phase = (math.atan2(imaginary, real) + PI) * INV_TWO_PI
    return imaginary / span * 0.5 + 0.5, phase, math.sqrt(real * real + imaginary * imaginary) / span
