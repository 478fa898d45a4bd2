# SPDX-License-Identifier: GPL-3.0-or-later
"""Albedo tables of microfacet lobes: loaded here, computed by `python -m engine.kernels.bsdf.tables`.

Definitions as in Cycles (Kulla and Conty 2017, "Revisiting Physically Based Shading at Imageworks", for the use of the
first four): roughness and cosine are sampled uniformly from [1e-4, 1], the refractive index at z in [1e-4, 0.99] with
z = sqrt((eta - 1) / (eta + 1)), averages are over 2 cos(theta) d cos(theta).
"""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import NamedTuple

import numpy as np

from engine.scene.arrays import Float32Array

_FILE = Path(__file__).with_name("tables.npz")


class BsdfTables(NamedTuple):
    """Albedos by roughness (last axis), cosine (second to last), refractive index z (third to last).

    glossy_albedo : float32 (32, 32), GGX reflection without Fresnel; glossy_mean : float32 (32,), its average
    glass_albedo : float32 (2, 16, 16, 16), GGX glass with dielectric Fresnel, [0] eta = ior(z), [1] eta = 1 / ior(z)
    glass_mean : float32 (2, 16, 16), its average
    fresnel_blend : float32 (16, 16, 16), mean of (F - F0) / (1 - F0) over visible normals that reflect upwards
    schlick_blend : float32 (16, 16), the same with Schlick's (1 - cos)^5
    sheen : float32 (3, 32, 32), LTC coefficients a, b and albedo by [roughness, cosine]
    """

    glossy_albedo: Float32Array
    glossy_mean: Float32Array
    glass_albedo: Float32Array
    glass_mean: Float32Array
    fresnel_blend: Float32Array
    schlick_blend: Float32Array
    sheen: Float32Array


@cache
def load_tables() -> BsdfTables:
    """The tables shipped with the package."""
    with np.load(_FILE) as stored:
        return BsdfTables(*(np.ascontiguousarray(stored[name], np.float32) for name in BsdfTables._fields))
