# SPDX-License-Identifier: GPL-3.0-or-later
"""Integrals over cells of the sphere of what is steep or infinite along their axis, as lobes of fibres are."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise

import numpy as np
import numpy.typing as npt

from engine.array_types import Float32Array

Float64Array = npt.NDArray[np.float64]


def cell_integrals(
    values_of: Callable[[Float32Array], Float32Array], rows: int, columns: int, nodes_per_cell: int = 8
) -> Float64Array:
    """Integrals over the cells of `tests.helpers.chi2.histogram`, whose axis is z: float64 (rows, columns).

    Parameters
    ----------
    values_of : callable
        Of directions, float32 (N, 3): float32 (N,).
    """
    nodes, weights = np.polynomial.legendre.leggauss(nodes_per_cell)

    def axis(edges: Float64Array) -> tuple[Float64Array, Float64Array]:
        step = np.diff(edges)[:, None]
        return (edges[:-1, None] + 0.5 * (nodes + 1.0) * step).ravel(), (0.5 * weights * step).ravel()

    # By the angle to the normal plane, as densities are infinite along the fibre.
    bounds = np.arcsin(np.linspace(-1.0, 1.0, rows + 1))
    theta, theta_weight = axis(np.concatenate([np.linspace(a, b, 5)[:-1] for a, b in pairwise(bounds)] + [bounds[-1:]]))
    phi, phi_weight = axis(np.linspace(0.0, 2.0 * np.pi, columns * 4 + 1))
    sine, cosine = np.sin(theta), np.cos(theta)
    z = np.broadcast_to(sine[:, None], (len(theta), len(phi)))
    directions = np.stack([np.outer(cosine, np.cos(phi)), np.outer(cosine, np.sin(phi)), z], axis=-1)
    found = values_of(np.ascontiguousarray(directions.reshape(-1, 3), np.float32)).astype(np.float64)
    found = found.reshape(len(theta), len(phi)) * (theta_weight * cosine)[:, None] * phi_weight
    return found.reshape(rows, -1, columns, found.shape[1] // columns).sum(axis=(1, 3))
