# SPDX-License-Identifier: GPL-3.0-or-later
"""Do two renderers' denoised pictures agree? Cells' means, and how they vary from seed to seed.

A denoiser spreads what it takes away: its pixels err together, and their variances say little of a cell's mean. What is
known of that is how it differs from seed to seed, of which there are few. So each cell's variance is drawn towards what
the noise of its pixels says, times what the picture's cells have of that altogether, and scores are Student's t.

References: Smyth 2004, "Linear models and empirical Bayes methods for assessing differential expression": moderated t.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from benchmarks.block_noise import student_score
from benchmarks.metrics import CELL_FLOOR, FloatArray, grid_edges

#: Seeds that what all cells say stands for.
_PRIOR_FREEDOM = 6


@dataclass(frozen=True)
class DenoisedComparison:
    """Differences of means of two renderers, relative to the second one's.

    difference, standard_error : float64 (rows, columns), of cells
    mean_difference, mean_error : float, of the picture
    freedom : int, degrees of freedom of the errors
    """

    difference: FloatArray
    standard_error: FloatArray
    mean_difference: float
    mean_error: float
    freedom: int

    def limits(self, sigmas: float) -> tuple[FloatArray, float]:
        """What differences of cells, and of the picture, are as unlikely as `sigmas` of normal noise."""
        score = student_score(sigmas, self.freedom)
        return score * self.standard_error, score * self.mean_error


def _cell_means(pixels: FloatArray, rows: FloatArray, columns: FloatArray) -> FloatArray:
    """Means over cells of the last two axes, by their bounds."""
    sums = np.add.reduceat(np.add.reduceat(pixels, rows[:-1], axis=-2), columns[:-1], axis=-1)
    return np.asarray(sums / (np.diff(rows)[:, None] * np.diff(columns)))


def compare_denoised(
    images_a: Sequence[FloatArray], images_b: Sequence[FloatArray], rows: int = 4, columns: int = 6
) -> DenoisedComparison:
    """Compare the cells of two renderers' denoised pictures, two or more seeds of each.

    Dark cells are compared relative to `CELL_FLOOR` of the picture's mean.
    """
    means, variance, by_pixels = [], 0.0, 0.0
    for images in (images_a, images_b):
        stack = np.stack([np.asarray(image, np.float64)[..., :3].mean(axis=-1) for image in images])
        edges = grid_edges(stack.shape[1], rows), grid_edges(stack.shape[2], columns)
        cells = _cell_means(stack, *edges)
        pixel_counts = np.diff(edges[0])[:, None] * np.diff(edges[1])
        means.append(cells.mean(axis=0))
        variance = variance + cells.var(axis=0, ddof=1) / len(stack)
        by_pixels = by_pixels + _cell_means(stack.var(axis=0, ddof=1), *edges) / (len(stack) * pixel_counts)
    ratio = max(float(np.sum(variance)) / max(float(np.sum(by_pixels)), 1e-30), 1.0)
    own = len(images_a) + len(images_b) - 2
    moderated = (own * variance + _PRIOR_FREEDOM * ratio * by_pixels) / (own + _PRIOR_FREEDOM)
    a, b = means
    mean_a, mean_b = float(a.mean()), float(b.mean())
    scale = max(abs(mean_b), 1e-12)
    denominator = np.maximum(np.abs(b), CELL_FLOOR * scale)
    return DenoisedComparison(
        (a - b) / denominator, np.sqrt(moderated) / denominator, (mean_a - mean_b) / scale,
        float(np.sqrt(moderated.sum())) / a.size / scale, own + _PRIOR_FREEDOM,
    )  # fmt: skip
