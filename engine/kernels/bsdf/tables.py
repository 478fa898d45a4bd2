# SPDX-License-Identifier: GPL-3.0-or-later
"""Albedo tables of microfacet lobes and the fit of sheen, computed by `engine.kernels.bsdf.precompute`."""

from __future__ import annotations

import threading
from functools import cache
from pathlib import Path

import numpy as np

from engine.array_types import Float32Array, Int64Array
from engine.kernels.bsdf.linked import FILM_TABLE, SELF
from engine.kernels.bsdf.lookup import TABLES_SIZE
from engine.kernels.bsdf.thin_film import film_table
from engine.runtime.bundle import Bundle
from engine.state.columns import aligned_bytes

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

    linked : int64 (W,), addresses of kernels that few scenes need, and the table of thin films (`linked.py`)
    """

    data: Float32Array
    linked: Int64Array


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
def _stored_tables() -> Float32Array:
    with np.load(TABLES_FILE) as stored:
        tables = [stored[name].astype(np.float32).reshape(shape).ravel() for name, shape in TABLE_SHAPES.items()]
    data = np.concatenate(tables)
    assert data.size == TABLES_SIZE
    return data


_made: dict[bytes, BsdfTables] = {}
_making = threading.Lock()


def load_tables(to_xyz: Float32Array | None = None) -> BsdfTables:
    """The tables shipped with the package, and that of thin films for a working space.

    Parameters
    ----------
    to_xyz : float32 (3, 3), optional
        From the scene's working space; Rec.709 if None.
    """
    with _making:
        key = b"" if to_xyz is None else np.asarray(to_xyz, np.float32).tobytes()
        if key not in _made:
            film = film_table(to_xyz)
            linked = aligned_bytes(8 * FILM_TABLE + film.nbytes).view(np.int64)
            linked[SELF] = linked.ctypes.data
            linked[FILM_TABLE:] = film.ravel().view(np.int64)
            _made[key] = BsdfTables(_stored_tables(), linked)
            _write_addresses(linked)
        return _made[key]


_addresses: dict[int, int] = {}


def _write_addresses(linked: Int64Array) -> None:
    for word, address in _addresses.items():
        linked[word] = address


def link_kernel(word: int, address: int) -> None:
    """Have all tables know where a linked kernel is."""
    with _making:
        _addresses[word] = address
        for tables in _made.values():
            _write_addresses(tables.linked)
