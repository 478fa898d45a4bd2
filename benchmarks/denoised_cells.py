# SPDX-License-Identifier: GPL-3.0-or-later
"""Do two renderers' denoised pictures agree? Cells' means, and how they vary from seed to seed.

A denoiser spreads what it takes away: its pixels err together, and their variances say little of a cell's mean. What is
known of that is how it differs from seed to seed, of which there are few. So each cell's variance is drawn towards what
the noise of its pixels says, times what the picture's cells have of that altogether, and scores are Student's t.

References: Smyth 2004, "Linear models and empirical Bayes methods for assessing differential expression": moderated t.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from benchmarks.block_noise import student_score
from benchmarks.metrics import CELL_FLOOR
from benchmarks.picture_means import FloatArray, PictureMeans

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


def compare_denoised(a: PictureMeans, b: PictureMeans) -> DenoisedComparison:
    """Compare the cells of two renderers' denoised pictures.

    Dark cells are compared relative to `CELL_FLOOR` of the picture's mean.
    """
    variance, by_pixels = a.cell_spreads + b.cell_spreads, a.cell_variances + b.cell_variances
    ratio = max(float(np.sum(variance)) / max(float(np.sum(by_pixels)), 1e-30), 1.0)
    own = a.seeds + b.seeds - 2
    moderated = (own * variance + _PRIOR_FREEDOM * ratio * by_pixels) / (own + _PRIOR_FREEDOM)
    mean_a, mean_b = float(a.cells.mean()), float(b.cells.mean())
    scale = max(abs(mean_b), 1e-12)
    denominator = np.maximum(np.abs(b.cells), CELL_FLOOR * scale)
    return DenoisedComparison(
        (a.cells - b.cells) / denominator, np.sqrt(moderated) / denominator, (mean_a - mean_b) / scale,
        float(np.sqrt(moderated.sum())) / a.cells.size / scale, own + _PRIOR_FREEDOM,
    )  # fmt: skip
