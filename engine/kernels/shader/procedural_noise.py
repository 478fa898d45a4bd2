# SPDX-License-Identifier: GPL-3.0-or-later
"""Perlin noise in 1 to 4 dimensions and the fractal sums of Blender's Noise texture.

One function a job, with branches on dimension and type at run time: variants compiled apart would cost seconds each.
Unused coordinates are zero.
"""

from typing import NamedTuple

import numpy as np

from engine.kernels.limits import at_least, clamp
from engine.kernels.rounding import floor_of
from engine.kernels.shader.procedural_hash import hash_1, hash_2, hash_3, hash_4
from engine.runtime.jit import in_python, kernel

NOISE_MULTIFRACTAL = 0
NOISE_FBM = 1
NOISE_HYBRID_MULTIFRACTAL = 2
NOISE_RIDGED_MULTIFRACTAL = 3
NOISE_HETERO_TERRAIN = 4

#: Noise repeats with this period: beyond it float32 has no fraction left to interpolate.
_PERIOD = np.float32(100000.0)
#: From here on every float32 is near an integer, where noise is zero: Cycles samples half-way between instead.
_PRECISION_LIMIT = np.float32(1000000.0)


class Fractal(NamedTuple):
    """How octaves of `perlin` add up: int64 and float32.

    Attributes
    ----------
    dimensions : int
        1 to 4.
    kind : int
        One of NOISE_*; `offset` and `gain` matter for the hybrid, ridged and hetero terrain kinds.
    detail : float32
        Octaves after the first; the last one weighs the fraction.
    roughness, lacunarity : float32
        Factor of the amplitude and of the frequency from one octave to the next.
    normalize : int
        Not 0: map to [0, 1] (FBM only).
    """

    dimensions: int
    kind: int
    detail: float
    roughness: float
    lacunarity: float
    offset: float
    gain: float
    normalize: int


def _offsets() -> np.ndarray:
    """Displacements in [100, 200] that stand in for a seed: row = seed, 4 coordinates; rows 6 to 8 for 1D."""

    def scaled(bits: int) -> np.float32:
        return np.float32(100.0) + np.float32(bits) * np.float32(1.0 / 4294967295.0) * np.float32(100.0)

    def bits(value: float) -> np.uint32:
        return np.float32(value).view(np.uint32)

    # In Python, so that importing this needs no machine code.
    hash_seed, hash_seed_and_axis = in_python(hash_1), in_python(hash_2)
    table = np.zeros((9, 4), np.float32)
    with np.errstate(over="ignore"):
        for seed in range(6):
            for axis in range(4):
                table[seed, axis] = scaled(hash_seed_and_axis(bits(seed), bits(axis)))
        for seed in range(3):
            table[6 + seed, 0] = scaled(hash_seed(bits(seed)))
    return table


_OFFSETS = _offsets()
_OFFSET_ROW_1D = 6


@kernel
def _fade(t):
    return t * t * t * (t * (t * 6.0 - 15.0) + 10.0)


@kernel
def _sign_by_bit(value, bits, mask):
    return -value if bits & mask else value


@kernel
def _gradient_1(bits, x):
    slope = np.float32(1 + (bits & 7))
    return _sign_by_bit(slope * x, bits, 8)


@kernel
def _gradient_2(bits, x, y):
    first = (bits & 7) < 4
    u = x if first else y
    v = y if first else x
    return _sign_by_bit(u, bits, 1) + 2.0 * _sign_by_bit(v, bits, 2)


@kernel
def _gradient_3(bits, x, y, z):
    h = bits & 15
    u = x if h < 8 else y
    other = x if h == 12 or h == 14 else z
    v = y if h < 4 else other
    return _sign_by_bit(u, h, 1) + _sign_by_bit(v, h, 2)


@kernel
def _gradient_4(bits, x, y, z, w):
    h = bits & 31
    u = x if h < 24 else y
    v = y if h < 16 else z
    s = z if h < 8 else w
    return _sign_by_bit(u, h, 1) + _sign_by_bit(v, h, 2) + _sign_by_bit(s, h, 4)


@kernel
def _wrap(p):
    if abs(p) < _PERIOD:
        return p
    wrapped = np.float32(np.fmod(p, _PERIOD))
    return wrapped + 0.5 if abs(p) >= _PRECISION_LIMIT else wrapped


@kernel
def perlin(x, y, z, w, dimensions):
    """Perlin gradient noise, roughly in [-1, 1].

    Corners are visited in a loop of which LLVM makes SIMD code.

    Parameters
    ----------
    x, y, z, w : float32
        Position; the first `dimensions` (1 to 4) count.

    References: Perlin 2002, "Improving Noise"; scales by the authors of Open Shading Language.
    """
    x = _wrap(x)
    floor_x = floor_of(x)
    fx = x - np.float32(floor_x)
    ux = _fade(fx)
    ix = np.uint32(floor_x)
    if dimensions == 1:
        left = _gradient_1(hash_1(ix), fx)
        right = _gradient_1(hash_1(np.uint32(ix + 1)), fx - 1.0)
        return 0.25 * (left + ux * (right - left))

    y = _wrap(y)
    floor_y = floor_of(y)
    fy = y - np.float32(floor_y)
    uy = _fade(fy)
    iy = np.uint32(floor_y)
    total = 0.0
    if dimensions == 2:
        for corner in range(4):
            i = corner & 1
            j = corner >> 1
            weight = (ux if i else 1.0 - ux) * (uy if j else 1.0 - uy)
            bits = hash_2(np.uint32(ix + i), np.uint32(iy + j))
            total += weight * _gradient_2(bits, fx - np.float32(i), fy - np.float32(j))
        return 0.6616 * total

    z = _wrap(z)
    floor_z = floor_of(z)
    fz = z - np.float32(floor_z)
    uz = _fade(fz)
    iz = np.uint32(floor_z)
    if dimensions == 3:
        for corner in range(8):
            i = corner & 1
            j = (corner >> 1) & 1
            k = corner >> 2
            weight = (ux if i else 1.0 - ux) * (uy if j else 1.0 - uy) * (uz if k else 1.0 - uz)
            bits = hash_3(np.uint32(ix + i), np.uint32(iy + j), np.uint32(iz + k))
            total += weight * _gradient_3(bits, fx - np.float32(i), fy - np.float32(j), fz - np.float32(k))
        return 0.982 * total

    w = _wrap(w)
    floor_w = floor_of(w)
    fw = w - np.float32(floor_w)
    uw = _fade(fw)
    iw = np.uint32(floor_w)
    for corner in range(16):
        i = corner & 1
        j = (corner >> 1) & 1
        k = (corner >> 2) & 1
        m = corner >> 3
        weight = (ux if i else 1.0 - ux) * (uy if j else 1.0 - uy)
        weight *= (uz if k else 1.0 - uz) * (uw if m else 1.0 - uw)
        bits = hash_4(np.uint32(ix + i), np.uint32(iy + j), np.uint32(iz + k), np.uint32(iw + m))
        total += weight * _gradient_4(
            bits, fx - np.float32(i), fy - np.float32(j), fz - np.float32(k), fw - np.float32(m)
        )
    return 0.8344 * total


@kernel
def fractal_noise(x, y, z, w, fractal):
    """Sum (or product) of octaves of `perlin`: float32.

    Parameters
    ----------
    x, y, z, w : float32
    fractal : Fractal

    References: Musgrave in Ebert et al. 2003, "Texturing and Modeling", chapter 16.
    """
    dimensions, kind, detail, roughness, lacunarity, offset, gain, normalize = fractal
    octave_count = int(detail) + 1
    remainder = detail - np.float32(octave_count - 1)
    last = octave_count if remainder != 0.0 and kind != NOISE_RIDGED_MULTIFRACTAL else octave_count - 1

    px, py, pz, pw = x, y, z, w
    scale = 1.0
    amplitude = 1.0
    amplitude_sum = 0.0
    weight = 1.0
    signal = 0.0
    value = 1.0 if kind == NOISE_MULTIFRACTAL else 0.0
    for octave in range(last + 1):
        part = remainder if octave == octave_count else 1.0
        noise = perlin(px, py, pz, pw, dimensions)
        if kind == NOISE_FBM:
            if octave == octave_count:
                partial = value + noise * amplitude
                if normalize:
                    value = 0.5 * value / amplitude_sum + 0.5
                    partial = 0.5 * partial / (amplitude_sum + amplitude) + 0.5
                return value + remainder * (partial - value)
            value += noise * amplitude
            amplitude_sum += amplitude
            amplitude *= roughness
        elif kind == NOISE_MULTIFRACTAL:
            value *= part * amplitude * noise + 1.0
            amplitude *= roughness
        elif kind == NOISE_HYBRID_MULTIFRACTAL:
            if not weight > 0.001:
                break
            weight = min(weight, 1.0)
            signal = (noise + offset) * amplitude
            value += part * weight * signal
            weight *= gain * signal
            amplitude *= roughness
        elif kind == NOISE_RIDGED_MULTIFRACTAL:
            if octave > 0:
                weight = min(max(signal * gain, 0.0), 1.0)
                amplitude *= roughness
            signal = offset - abs(noise)
            signal *= signal * weight
            value += signal * amplitude
        elif octave == 0:
            value = offset + noise
            amplitude = roughness
        else:
            value += part * (noise + offset) * amplitude * value
            amplitude *= roughness
        if kind == NOISE_FBM:  # FBM scales the position afresh, the others step by step; Cycles rounds alike
            scale *= lacunarity
            px, py, pz, pw = x * scale, y * scale, z * scale, w * scale
        else:
            px, py, pz, pw = px * lacunarity, py * lacunarity, pz * lacunarity, pw * lacunarity
    if kind == NOISE_FBM and normalize:
        return 0.5 * value / amplitude_sum + 0.5
    return value


@kernel
def noise_texture(x, y, z, w, fractal, distortion, channel_count):
    """Blender's Noise texture at a position already multiplied by the scale.

    Parameters
    ----------
    x, y, z, w : float32
    fractal : Fractal
        As the sockets have it: detail and roughness are clamped here.
    distortion : float32
    channel_count : int
        1 if only the float output is wanted, else 3.

    Returns
    -------
    3 float32
        The colour output; its first channel is the float output.
    """
    dimensions, kind, detail, roughness, lacunarity, offset, gain, normalize = fractal
    detail = clamp(detail, 0.0, 15.0)
    roughness = at_least(roughness, 0.0)
    clamped = Fractal(dimensions, kind, detail, roughness, lacunarity, offset, gain, normalize)
    first_row = _OFFSET_ROW_1D if dimensions == 1 else 0
    px, py, pz, pw = x, y, z, w
    if distortion != 0.0:
        for axis in range(dimensions):
            row = first_row + axis
            shift = distortion * perlin(
                x + _OFFSETS[row, 0], y + _OFFSETS[row, 1], z + _OFFSETS[row, 2], w + _OFFSETS[row, 3], dimensions
            )
            if axis == 0:
                px += shift
            elif axis == 1:
                py += shift
            elif axis == 2:
                pz += shift
            else:
                pw += shift

    red = 0.0
    green = 0.0
    blue = 0.0
    for channel in range(channel_count):
        ox = 0.0
        oy = 0.0
        oz = 0.0
        ow = 0.0
        if channel > 0:
            row = first_row + dimensions + channel - 1
            ox, oy, oz, ow = _OFFSETS[row, 0], _OFFSETS[row, 1], _OFFSETS[row, 2], _OFFSETS[row, 3]
        value = fractal_noise(px + ox, py + oy, pz + oz, pw + ow, clamped)
        if channel == 0:
            red = value
        elif channel == 1:
            green = value
        else:
            blue = value
    return red, green, blue
