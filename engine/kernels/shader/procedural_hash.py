# SPDX-License-Identifier: GPL-3.0-or-later
"""Integer hashes behind the procedural textures: Jenkins' lookup3 and PCG on 2 to 4 integers.

The results are bits: they must be the same as in Cycles, or the picture is another one. Numba widens every uint32
operation to 64 bits, so each result is cut back to 32.
"""

import numpy as np

from engine.runtime.jit import kernel

# Seeds of lookup3 for 1 to 4 words: 0xdeadbeef + 4 * word count + 13.
_SEED_1 = np.uint32(0xDEADBEEF + 4 + 13)
_SEED_2 = np.uint32(0xDEADBEEF + 8 + 13)
_SEED_3 = np.uint32(0xDEADBEEF + 12 + 13)
_SEED_4 = np.uint32(0xDEADBEEF + 16 + 13)

_PCG_MULTIPLIER = np.int32(1664525)
_PCG_INCREMENT = np.int32(1013904223)

_UNIT_FROM_UINT32 = np.float32(1.0 / 4294967295.0)
_UNIT_FROM_INT31 = np.float32(1.0 / 2147483647.0)


@kernel
def _rotate(x, count):
    return np.uint32((np.uint64(x) << np.uint64(count)) | (np.uint64(x) >> np.uint64(32 - count)))


@kernel
def _finish(a, b, c):
    """lookup3's final mixing of three words; the third is the hash."""
    c = np.uint32((c ^ b) - _rotate(b, 14))
    a = np.uint32((a ^ c) - _rotate(c, 11))
    b = np.uint32((b ^ a) - _rotate(a, 25))
    c = np.uint32((c ^ b) - _rotate(b, 16))
    a = np.uint32((a ^ c) - _rotate(c, 4))
    b = np.uint32((b ^ a) - _rotate(a, 14))
    return np.uint32((c ^ b) - _rotate(b, 24))


@kernel
def hash_1(x):
    """lookup3 hash of one uint32."""
    return _finish(np.uint32(_SEED_1 + x), _SEED_1, _SEED_1)


@kernel
def hash_2(x, y):
    """lookup3 hash of two uint32."""
    return _finish(np.uint32(_SEED_2 + x), np.uint32(_SEED_2 + y), _SEED_2)


@kernel
def hash_3(x, y, z):
    """lookup3 hash of three uint32."""
    return _finish(np.uint32(_SEED_3 + x), np.uint32(_SEED_3 + y), np.uint32(_SEED_3 + z))


@kernel
def hash_4(x, y, z, w):
    """lookup3 hash of four uint32 (one round of mixing, then the fourth word)."""
    a = np.uint32(_SEED_4 + x)
    b = np.uint32(_SEED_4 + y)
    c = np.uint32(_SEED_4 + z)
    a = np.uint32(a - c) ^ _rotate(c, 4)
    c = np.uint32(c + b)
    b = np.uint32(b - a) ^ _rotate(a, 6)
    a = np.uint32(a + c)
    c = np.uint32(c - b) ^ _rotate(b, 8)
    b = np.uint32(b + a)
    a = np.uint32(a - c) ^ _rotate(c, 16)
    c = np.uint32(c + b)
    b = np.uint32(b - a) ^ _rotate(a, 19)
    a = np.uint32(a + c)
    c = np.uint32(c - b) ^ _rotate(b, 4)
    b = np.uint32(b + a)
    return _finish(np.uint32(a + w), np.uint32(b), np.uint32(c))


@kernel
def float_bits(x):
    """The bit pattern of a float32."""
    return np.float32(x).view(np.uint32)


@kernel
def unit_1(x):
    """Hash of a float to [0, 1]."""
    return np.float32(hash_1(float_bits(x))) * _UNIT_FROM_UINT32


@kernel
def unit_2(x, y):
    """Hash of two floats to [0, 1]."""
    return np.float32(hash_2(float_bits(x), float_bits(y))) * _UNIT_FROM_UINT32


@kernel
def unit_3(x, y, z):
    """Hash of three floats to [0, 1]."""
    return np.float32(hash_3(float_bits(x), float_bits(y), float_bits(z))) * _UNIT_FROM_UINT32


@kernel
def unit_4(x, y, z, w):
    """Hash of four floats to [0, 1]."""
    bits = hash_4(float_bits(x), float_bits(y), float_bits(z), float_bits(w))
    return np.float32(bits) * _UNIT_FROM_UINT32


@kernel
def _pcg_unit(x):
    return np.float32(x & np.int32(0x7FFFFFFF)) * _UNIT_FROM_INT31


@kernel
def pcg_2(x, y):
    """PCG hash of two int32 to a point of the unit square.

    References: Jarzynski and Olano 2020, "Hash Functions for GPU Rendering" (pcg2d, with signed shifts as Cycles).
    """
    x = np.int32(x * _PCG_MULTIPLIER + _PCG_INCREMENT)
    y = np.int32(y * _PCG_MULTIPLIER + _PCG_INCREMENT)
    x = np.int32(x + y * _PCG_MULTIPLIER)
    y = np.int32(y + x * _PCG_MULTIPLIER)
    x = np.int32(x ^ (x >> 16))
    y = np.int32(y ^ (y >> 16))
    x = np.int32(x + y * _PCG_MULTIPLIER)
    y = np.int32(y + x * _PCG_MULTIPLIER)
    return _pcg_unit(x), _pcg_unit(y)


@kernel
def pcg_3(x, y, z):
    """PCG hash of three int32 to a point of the unit cube (pcg3d of the same paper)."""
    x = np.int32(x * _PCG_MULTIPLIER + _PCG_INCREMENT)
    y = np.int32(y * _PCG_MULTIPLIER + _PCG_INCREMENT)
    z = np.int32(z * _PCG_MULTIPLIER + _PCG_INCREMENT)
    x = np.int32(x + y * z)
    y = np.int32(y + z * x)
    z = np.int32(z + x * y)
    x = np.int32(x ^ (x >> 16))
    y = np.int32(y ^ (y >> 16))
    z = np.int32(z ^ (z >> 16))
    x = np.int32(x + y * z)
    y = np.int32(y + z * x)
    z = np.int32(z + x * y)
    return _pcg_unit(x), _pcg_unit(y), _pcg_unit(z)


@kernel
def pcg_4(x, y, z, w):
    """PCG hash of four int32 to a point of the unit hypercube (pcg4d of the same paper)."""
    x = np.int32(x * _PCG_MULTIPLIER + _PCG_INCREMENT)
    y = np.int32(y * _PCG_MULTIPLIER + _PCG_INCREMENT)
    z = np.int32(z * _PCG_MULTIPLIER + _PCG_INCREMENT)
    w = np.int32(w * _PCG_MULTIPLIER + _PCG_INCREMENT)
    x = np.int32(x + y * w)
    y = np.int32(y + z * x)
    z = np.int32(z + x * y)
    w = np.int32(w + y * z)
    x = np.int32(x ^ (x >> 16))
    y = np.int32(y ^ (y >> 16))
    z = np.int32(z ^ (z >> 16))
    w = np.int32(w ^ (w >> 16))
    x = np.int32(x + y * w)
    y = np.int32(y + z * x)
    z = np.int32(z + x * y)
    w = np.int32(w + y * z)
    return _pcg_unit(x), _pcg_unit(y), _pcg_unit(z), _pcg_unit(w)
