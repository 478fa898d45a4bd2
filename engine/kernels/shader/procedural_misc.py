# SPDX-License-Identifier: GPL-3.0-or-later
"""The small procedural textures: checker, gradient, wave, brick, magic and white noise."""

import math

import numpy as np

from engine.kernels.constants import HALF_PI, INV_TWO_PI, TWO_PI
from engine.kernels.limits import at_least, clamp, clamp_unit
from engine.kernels.rounding import floor_of
from engine.kernels.shader.procedural_hash import unit_1, unit_2, unit_3, unit_4
from engine.kernels.shader.procedural_noise import NOISE_FBM, Fractal, fractal_noise
from engine.runtime.jit import kernel

GRADIENT_LINEAR = 0
GRADIENT_QUADRATIC = 1
GRADIENT_EASING = 2
GRADIENT_DIAGONAL = 3
GRADIENT_RADIAL = 4
GRADIENT_QUADRATIC_SPHERE = 5
GRADIENT_SPHERICAL = 6

WAVE_BANDS = 0
WAVE_RINGS = 1

WAVE_X = 0
WAVE_Y = 1
WAVE_Z = 2
#: Bands run diagonally, rings are spherical.
WAVE_OTHER = 3

WAVE_SINE = 0
WAVE_SAW = 1
WAVE_TRIANGLE = 2

# Keeps points on integer coordinates, which surfaces love, on one side of the step.
_NUDGE = np.float32(0.000001)
_SHRINK = np.float32(0.999999)


@kernel
def checker(x, y, z):
    """1 on the first colour's cubes of the unit checkerboard (odd sum of indices), 0 on the second's."""
    i = floor_of((x + _NUDGE) * _SHRINK)
    j = floor_of((y + _NUDGE) * _SHRINK)
    k = floor_of((z + _NUDGE) * _SHRINK)
    return 1.0 if (i + j + k) & 1 else 0.0


@kernel
def gradient(x, y, z, kind):
    """Blender's Gradient texture, clamped to [0, 1]."""
    value = 0.0
    if kind == GRADIENT_LINEAR:
        value = x
    elif kind == GRADIENT_QUADRATIC:
        value = at_least(x, 0.0)
        value *= value
    elif kind == GRADIENT_EASING:
        value = clamp_unit(x)
        value = value * value * (3.0 - 2.0 * value)
    elif kind == GRADIENT_DIAGONAL:
        value = 0.5 * (x + y)
    elif kind == GRADIENT_RADIAL:
        value = math.atan2(y, x) * INV_TWO_PI + 0.5
    else:
        value = max(_SHRINK - math.sqrt(x * x + y * y + z * z), 0.0)
        if kind == GRADIENT_QUADRATIC_SPHERE:
            value *= value
    return clamp_unit(value)


@kernel
def wave(x, y, z, kind, direction, profile, distortion, detail, detail_scale, detail_roughness, phase):
    """Blender's Wave texture at a scaled position, in [0, 1].

    `detail` is limited to [0, 15], Blender's own range for an unlinked socket: a number of octaves must be bounded.
    """
    x = (x + _NUDGE) * _SHRINK
    y = (y + _NUDGE) * _SHRINK
    z = (z + _NUDGE) * _SHRINK
    angle = 0.0
    if kind == WAVE_BANDS:
        if direction == WAVE_X:
            angle = x * 20.0
        elif direction == WAVE_Y:
            angle = y * 20.0
        elif direction == WAVE_Z:
            angle = z * 20.0
        else:
            angle = (x + y + z) * 10.0
    else:
        rx = 0.0 if direction == WAVE_X else x
        ry = 0.0 if direction == WAVE_Y else y
        rz = 0.0 if direction == WAVE_Z else z
        angle = math.sqrt(rx * rx + ry * ry + rz * rz) * 20.0
    angle += phase
    if distortion != 0.0:
        detail = clamp(detail, 0.0, 15.0)
        fractal = Fractal(
            dimensions=3,
            kind=NOISE_FBM,
            detail=detail,
            roughness=detail_roughness,
            lacunarity=2.0,
            offset=0.0,
            gain=0.0,
            normalize=1,
        )
        noise = fractal_noise(x * detail_scale, y * detail_scale, z * detail_scale, 0.0, fractal)
        angle += distortion * (noise * 2.0 - 1.0)
    if profile == WAVE_SINE:
        return 0.5 + 0.5 * math.sin(angle - HALF_PI)
    turns = angle / TWO_PI
    if profile == WAVE_SAW:
        return turns - np.float32(floor_of(turns))
    return 2.0 * abs(turns - np.float32(floor_of(turns + 0.5)))


@kernel
def _brick_hash(bits):
    """Integer noise in [0, 1) for a brick's tint."""
    n = np.uint32((np.uint32(bits) + 1013) & 0x7FFFFFFF)
    n = np.uint32((n >> 13) ^ n)
    square = np.uint32(np.uint32(n * n) * 60493 + 19990303)
    n = np.uint32(np.uint32(n * square) + 1376312589) & 0x7FFFFFFF
    return 0.5 * (np.float32(n) / 1073741824.0)


@kernel
def brick(
    x, y, mortar_size, mortar_smooth, bias, brick_width, row_height,
    offset, offset_frequency, squash, squash_frequency,
):  # fmt: skip
    """Blender's Brick texture at a scaled position.

    Returns
    -------
    tint, mortar : float32
        Share of the second brick colour, share of mortar.
    """
    row = floor_of(y / row_height)
    shift = 0.0
    if offset_frequency != 0 and squash_frequency != 0:
        if row % squash_frequency == 0:
            brick_width *= squash
        if row % offset_frequency == 0:
            shift = brick_width * offset
    number = floor_of((x + shift) / brick_width)
    x = x + shift - brick_width * np.float32(number)
    y = y - row_height * np.float32(row)
    tint = clamp_unit(_brick_hash((row << 16) + (number & 0xFFFF)) + bias)
    distance = min(min(x, y), min(brick_width - x, row_height - y))
    if distance >= mortar_size:
        return tint, 0.0
    if mortar_smooth == 0.0:
        return tint, 1.0
    t = clamp_unit((1.0 - distance / mortar_size) / mortar_smooth)
    return tint, t * t * (3.0 - 2.0 * t)


@kernel
def magic(x, y, z, scale, depth, distortion, wraps_scaled):
    """Blender's Magic texture: sines and cosines of one another, `depth` times; three channels.

    Coordinates are wrapped lest large ones lose their digits: `wraps_scaled`, after scaling, as from Blender 5.2 on.
    """
    if wraps_scaled:
        x *= scale
        y *= scale
        z *= scale
        scale = 1.0
    x = np.float32(np.fmod(x, TWO_PI))
    y = np.float32(np.fmod(y, TWO_PI))
    z = np.float32(np.fmod(z, TWO_PI))
    factor = 5.0 * scale
    a = math.sin((x + y + z) * factor)
    b = math.cos((-x + y - z) * factor)
    c = -math.cos((-x - y + z) * factor)
    if depth > 0:
        a *= distortion
        b *= distortion
        c *= distortion
        b = -math.cos(a - b + c) * distortion
    if depth > 1:
        a = math.cos(a - b - c) * distortion
    if depth > 2:
        c = math.sin(-a - b - c) * distortion
    if depth > 3:
        a = -math.cos(-a + b - c) * distortion
    if depth > 4:
        b = -math.sin(-a + b + c) * distortion
    if depth > 5:
        b = -math.cos(-a + b + c) * distortion
    if depth > 6:
        a = math.cos(a + b + c) * distortion
    if depth > 7:
        c = math.sin(a + b - c) * distortion
    if depth > 8:
        a = -math.cos(-a - b + c) * distortion
    if depth > 9:
        b = -math.sin(a - b + c) * distortion
    if distortion != 0.0:
        half = 0.5 / distortion
        a *= half
        b *= half
        c *= half
    return 0.5 - a, 0.5 - b, 0.5 - c


@kernel
def white_noise(x, y, z, w, dimensions):
    """Blender's White Noise texture (1D: `w`): value, then colour; any change of a coordinate gives another value."""
    if dimensions == 1:
        value = unit_1(w)
        return value, value, unit_2(w, 1.0), unit_2(w, 2.0)
    if dimensions == 2:
        value = unit_2(x, y)
        return value, value, unit_3(x, y, 1.0), unit_3(x, y, 2.0)
    if dimensions == 3:
        value = unit_3(x, y, z)
        return value, value, unit_4(x, y, z, 1.0), unit_4(x, y, z, 2.0)
    value = unit_4(x, y, z, w)
    return value, value, unit_4(z, x, w, y), unit_4(w, z, y, x)
