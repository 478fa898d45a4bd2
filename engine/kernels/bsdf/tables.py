# SPDX-License-Identifier: GPL-3.0-or-later
"""Albedo tables of microfacet lobes and the fit of sheen, computed by `engine.kernels.bsdf.precompute`."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np

from engine.array_types import Float32Array
from engine.kernels.bsdf.lookup import TABLES_SIZE
from engine.runtime.bundle import Bundle

TABLES_FILE = Path(__file__).with_name("tables.npz")


class BsdfTables(Bundle):
    """All tables in one array (a tuple of arrays would cost every call that passes it on).

    data : float32 (TABLES_SIZE,), the tables of `TABLE_SHAPES` at the offsets of `engine.kernels.bsdf.lookup`

    Columns are roughness and rows the cosine unless said otherwise, all from 0 to 1. The refractive index z is
    sqrt((eta - 1) / (eta + 1)). Averages are over 2 cos(theta) d cos(theta).

    glossy_albedo : GGX reflection without Fresnel; glossy_mean : its average
    glass_albedo : GGX glass; planes are z, 16 of eta = ior(z), then 16 of eta = 1 / ior(z)
    glass_mean : its average; planes are eta above and below 1, rows z
    fresnel_blend : planes are z; mean of (F - F0) / (1 - F0) over the visible normals that reflect upwards
    schlick_blend : the same with Schlick's (1 - cos)^5
    sheen : transformed cosine's a, b and the albedo; rows are roughness, columns the cosine
    """

    data: Float32Array


TABLE_SHAPES = {
    "glossy_albedo": (1, 32, 32),
    "glossy_mean": (1, 1, 32),
    "glass_albedo": (32, 16, 16),
    "glass_mean": (2, 16, 16),
    "fresnel_blend": (16, 16, 16),
    "schlick_blend": (1, 16, 16),
    "sheen": (3, 32, 32),
}


@cache
def load_tables() -> BsdfTables:
    """The tables shipped with the package."""
    with np.load(TABLES_FILE) as stored:
        tables = [stored[name].astype(np.float32).reshape(shape).ravel() for name, shape in TABLE_SHAPES.items()]
    data = np.concatenate(tables)
    assert data.size == TABLES_SIZE
    return BsdfTables(data)
