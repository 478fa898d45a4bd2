# SPDX-License-Identifier: GPL-3.0-or-later
"""Cryptomatte: ids of names, and what a file says of them.

References
----------
Friedman and Jones 2015, "Fully Automatic ID Mattes with Support for Motion Blur and Transparency"; the Cryptomatte
specification 1.2.0 (Psyop), sections on hashing, conversion and metadata; Appleby, MurmurHash3 (x86, 32 bits).
"""

from __future__ import annotations

import json
from collections.abc import Iterable

import numpy as np

_MASK = 0xFFFFFFFF


def _rotate(x: int, bits: int) -> int:
    return ((x << bits) | (x >> (32 - bits))) & _MASK


def _scramble(block: int) -> int:
    return _rotate(block * 0xCC9E2D51 & _MASK, 15) * 0x1B873593 & _MASK


def murmur_hash(text: str) -> int:
    """MurmurHash3_32 of a text's UTF-8, with the seed 0."""
    data = text.encode()
    whole = len(data) // 4 * 4
    state = 0
    for block in np.frombuffer(data[:whole], "<u4").tolist():
        state = (_rotate(state ^ _scramble(block), 13) * 5 + 0xE6546B64) & _MASK
    state ^= _scramble(int.from_bytes(data[whole:], "little"))
    state ^= len(data)
    state = (state ^ state >> 16) * 0x85EBCA6B & _MASK
    state = (state ^ state >> 13) * 0xC2B2AE35 & _MASK
    return state ^ state >> 16


def matte_id(name: str) -> np.float32:
    """Id of a name in pictures: its hash as a float that is neither zero, denormal, infinite nor NaN."""
    number = murmur_hash(name)
    exponent = min(max(number >> 23 & 0xFF, 1), 254)
    return np.uint32(number & 0x807FFFFF | exponent << 23).view(np.float32)


def matte_ids(names: Iterable[str]) -> np.ndarray:
    """Ids of names, float32 (N,); equal names are hashed once."""
    listed = list(names)
    known = {name: matte_id(name) for name in set(listed)}
    return np.array([known[name] for name in listed], np.float32)


def matte_metadata(layer: str, names: Iterable[str]) -> dict[str, str]:
    """Fields that a file needs for others to know the mattes of a layer by their names.

    Parameters
    ----------
    layer : str
        What its channels' names begin with, as "ViewLayer.CryptoObject".
    names : iterable of str
        Everything that may have an id in it.
    """
    manifest = {name: f"{murmur_hash(name):08x}" for name in sorted(set(names))}
    prefix = f"cryptomatte/{murmur_hash(layer):08x}"[:-1]
    return {
        f"{prefix}/name": layer,
        f"{prefix}/hash": "MurmurHash3_32",
        f"{prefix}/conversion": "uint32_to_float32",
        f"{prefix}/manifest": json.dumps(manifest, ensure_ascii=False, separators=(",", ":")),
    }
