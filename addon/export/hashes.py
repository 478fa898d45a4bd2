# SPDX-License-Identifier: GPL-3.0-or-later
"""Cycles' random numbers of objects, strands and points: hashes (Jenkins' lookup3, 2006)."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from engine.array_types import Float32Array

_MASK = 0xFFFFFFFF


def lookup3(x: Any, words: int = 2) -> Any:
    """Hashes, 0 to 2^32 - 1, of two words: `x`, a number from 0 to 2^32 - 1 or an int64 array of such, and 0.

    Of one word, `x`, where `words` is 1.
    """
    b = c = 0xDEADBEEF + (words << 2) + 13
    a = (b + x) & _MASK

    c = ((c ^ b) - _rotate(b, 14)) & _MASK
    a = ((a ^ c) - _rotate(c, 11)) & _MASK
    b = ((b ^ a) - _rotate(a, 25)) & _MASK
    c = ((c ^ b) - _rotate(b, 16)) & _MASK
    a = ((a ^ c) - _rotate(c, 4)) & _MASK
    b = ((b ^ a) - _rotate(a, 14)) & _MASK
    return ((c ^ b) - _rotate(b, 24)) & _MASK


def hash_to_unit(numbers: npt.NDArray[np.int64]) -> Float32Array:
    """Random numbers of strands and points, float32 (N,) from 0 to 1, by their index."""
    hashes: npt.NDArray[np.int64] = lookup3(numbers)
    return hashes.astype(np.float32) * np.float32(1.0 / 0xFFFFFFFF)


def hash_word_to_unit(numbers: npt.NDArray[np.int64]) -> Float32Array:
    """Random numbers of islands, float32 (N,) from 0 to 1, by their index."""
    hashes: npt.NDArray[np.int64] = lookup3(numbers, 1)
    return hashes.astype(np.float32) * np.float32(1.0 / 0xFFFFFFFF)


def _rotate(x: Any, k: int) -> Any:
    return ((x << k) | (x >> (32 - k))) & _MASK
