# SPDX-License-Identifier: GPL-3.0-or-later
"""Albedo tables of microfacet lobes and the fit of sheen, computed by `engine.kernels.bsdf.precompute`."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import NamedTuple

import numpy as np

from engine.scene.arrays import Float32Array

TABLES_FILE = Path(__file__).with_name("tables.npz")


class BsdfTables(NamedTuple):
    """Tables of three axes; columns are roughness, rows the cosine unless said otherwise, all from 0 to 1.

    The refractive index z is sqrt((eta - 1) / (eta + 1)). Averages are over 2 cos(theta) d cos(theta).

    glossy_albedo : float32 (1, 32, 32), GGX reflection without Fresnel
    glossy_mean : float32 (1, 1, 32), its average
    glass_albedo : float32 (32, 16, 16), GGX glass; planes are z, 16 of eta = ior(z), then 16 of eta = 1 / ior(z)
    glass_mean : float32 (2, 16, 16), its average; planes are eta above and below 1, rows z
    fresnel_blend : float32 (16, 16, 16), planes z: mean of (F - F0) / (1 - F0) over visible normals that reflect upwards
    schlick_blend : float32 (1, 16, 16), the same with Schlick's (1 - cos)^5
    sheen : float32 (3, 32, 32), transformed cosine's a, b and the albedo; rows are roughness, columns the cosine
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
    with np.load(TABLES_FILE) as stored:
        return BsdfTables(*(np.ascontiguousarray(stored[name], np.float32) for name in BsdfTables._fields))
