# SPDX-License-Identifier: GPL-3.0-or-later
"""Chi-square test of a sampler of directions against its density, shared by the tests of lobes and lights."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import numpy.typing as npt
from scipy import stats

FloatArray = npt.NDArray[np.floating]

#: Cells expecting fewer samples are pooled.
MIN_EXPECTED = 5.0


def sidak(significance: float, test_count: int) -> float:
    """Level of each of `test_count` independent tests for a family-wise `significance`."""
    return 1.0 - (1.0 - significance) ** (1.0 / test_count)


def cell_integrals(
    pdf: Callable[[FloatArray], FloatArray], cos_bins: int, phi_bins: int, points: int = 8, subdivisions: int = 1
) -> FloatArray:
    """Integrate `pdf` over cells of equal solid angle, uniform in (cos theta, phi).

    Parameters
    ----------
    pdf : callable
        Directions, float (N, 3), to density [sr^-1], float (N,).
    points : int
        Gauss-Legendre points a side of a sub-cell.
    subdivisions : int
        Sub-cells a side of a cell: raise it where the density has kinks or is narrow.

    Returns
    -------
    float64 (cos_bins, phi_bins)
    """
    nodes, weights = np.polynomial.legendre.leggauss(points)
    nodes, weights = 0.5 * (nodes + 1.0), 0.5 * weights

    def axis(count: int) -> FloatArray:
        return (np.arange(count)[:, None] + nodes).ravel() / count

    z = -1.0 + 2.0 * axis(cos_bins * subdivisions)
    phi = 2.0 * np.pi * axis(phi_bins * subdivisions)
    sine = np.sqrt(1.0 - z**2)
    directions = np.stack(
        [np.outer(sine, np.cos(phi)), np.outer(sine, np.sin(phi)), np.broadcast_to(z[:, None], (z.size, phi.size))], -1
    )
    density = np.asarray(pdf(directions.reshape(-1, 3)), np.float64).reshape(
        cos_bins, subdivisions, points, phi_bins, subdivisions, points
    )
    mean = np.einsum("asibtj,i,j->ab", density, weights, weights) / subdivisions**2
    return mean * 4.0 * np.pi / (cos_bins * phi_bins)


def histogram(directions: FloatArray, cos_bins: int, phi_bins: int) -> FloatArray:
    """Count directions, float (N, 3), in the cells of `cell_integrals`."""
    rows = np.clip(((directions[:, 2] + 1.0) * 0.5 * cos_bins).astype(int), 0, cos_bins - 1)
    phi = np.arctan2(directions[:, 1], directions[:, 0]) / (2.0 * np.pi) % 1.0
    columns = np.clip((phi * phi_bins).astype(int), 0, phi_bins - 1)
    return np.bincount(rows * phi_bins + columns, minlength=cos_bins * phi_bins).reshape(cos_bins, phi_bins)


def p_value(observed: FloatArray, probability: FloatArray, sample_count: int) -> float:
    """p-value of cell counts, given each cell's probability.

    Samples that were rejected, `sample_count` minus the sum of `observed`, are one more cell, with the probability that
    is missing from 1. A small p-value says sampler and density disagree.
    """
    cells = np.append(observed.ravel(), sample_count - observed.sum())
    expected = np.append(probability.ravel(), max(1.0 - probability.sum(), 0.0)) * sample_count
    order = np.argsort(expected)
    cells, expected = cells[order], expected[order]
    pooled = int(np.searchsorted(np.cumsum(expected), MIN_EXPECTED)) + 1
    pooled = max(pooled, int(np.searchsorted(expected, MIN_EXPECTED)))
    pooled = min(pooled, expected.size - 1)
    cells = np.append(cells[:pooled].sum(), cells[pooled:])
    expected = np.append(expected[:pooled].sum(), expected[pooled:])
    if expected[0] < MIN_EXPECTED:
        if cells[0] > 0 and stats.poisson.sf(cells[0] - 1, max(expected[0], 1e-12)) < 1e-9:
            return 0.0
        cells, expected = cells[1:], expected[1:]
    expected *= cells.sum() / expected.sum()
    statistic = float(np.sum((cells - expected) ** 2 / expected))
    return float(stats.chi2.sf(statistic, cells.size - 1))
