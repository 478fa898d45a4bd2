# SPDX-License-Identifier: GPL-3.0-or-later
"""Is a picture biased? Z-tests of means over independent seeds, and how large a bias they would have found.

The noise of a picture's mean comes from sums over blocks of pixels, which are independent (`benchmarks.block_noise`):
many blocks say more about it than a handful of seeds' means. A cell has few blocks. Its noise comes from the variances
of its pixels, as if they were independent, times what blocks have said of all the picture, if that is more than one.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from statistics import NormalDist

import numpy as np

from benchmarks import metrics
from benchmarks.block_noise import joint_freedom, mean_noise, normal_score, student_score
from benchmarks.metrics import FloatArray

#: Chance that an unbiased picture is called biased, for normal noise. Half of it goes to the mean of the whole picture,
#: half to its channels and cells together (Bonferroni).
SIGNIFICANCE = 1e-4
#: Probability with which a bias of `BiasTest.detectable` is found.
POWER = 0.95
#: Cells a side at most, and pixels that a cell needs: of fewer, two seeds do not tell how noisy it is.
GRID, LEAST_CELL_PIXELS = 4, 64

_PARTS = 3 + GRID * GRID
MEAN_LIMIT = NormalDist().inv_cdf(1.0 - SIGNIFICANCE / 4.0)
PART_LIMIT = NormalDist().inv_cdf(1.0 - SIGNIFICANCE / (4.0 * _PARTS))


@dataclass(frozen=True)
class BiasTest:
    """Means of a method against those of a reference, both with their noise.

    difference, error : of the picture's mean over pixels and channels, relative to the reference's; its standard error
    z : the difference in standard errors, as a normal score: as many as make it as unlikely for normal noise of known
        variance
    worst_z : largest of a channel's mean or of a cell's, likewise
    worst_part : which that is, 'R', 'G', 'B' or 'cell (column, row)', row 0 as in the pictures
    worst_difference : its relative difference
    detectable : relative bias of the whole picture that is found with probability POWER
    """

    difference: float
    error: float
    z: float
    worst_z: float
    worst_part: str
    worst_difference: float
    detectable: float

    @property
    def is_biased(self) -> bool:
        """Whether chance is no explanation; pictures that are not numbers are no numbers to be unbiased with."""
        return not (self.z <= MEAN_LIMIT and self.worst_z <= PART_LIMIT)

    def __str__(self) -> str:
        return (
            f"mean {100 * self.difference:+.2f}% ± {100 * self.error:.2f}% (z {self.z:.1f}, limit {MEAN_LIMIT:.1f}), "
            f"worst part {self.worst_part} {100 * self.worst_difference:+.1f}% (z {self.worst_z:.1f}, limit "
            f"{PART_LIMIT:.1f}); finds a bias of {100 * self.detectable:.2f}% {100 * POWER:.0f} times in a hundred"
        )


def find_bias(images: Sequence[FloatArray], references: Sequence[FloatArray]) -> BiasTest:
    """Test whether `images` have the mean of `references`, each two or more independent pictures of the same size.

    Parameters
    ----------
    images, references : sequence of float (height, width, 3 or more)
        Pictures of two sets of seeds with none in common. Means over seeds are compared, so the two may have different
        numbers of samples.
    """
    a = [np.asarray(image, np.float64)[..., :3] for image in images]
    b = [np.asarray(image, np.float64)[..., :3] for image in references]
    grey = [[image.mean(axis=-1, keepdims=True) for image in images] for images in (a, b)]
    grey_difference, grey_error, grey_freedom, correlation = _compare_means(*grey)
    difference, error = float(grey_difference[0]), float(grey_error[0])
    channels, channel_errors, freedom, _ = _compare_means(a, b)
    side = min(max(int(math.sqrt(a[0].shape[0] * a[0].shape[1] / LEAST_CELL_PIXELS)), 1), GRID)
    cells = metrics.compare_cells(a, b, side, side)
    names = ["R", "G", "B"] + [f"cell ({x}, {y})" for y, x in np.ndindex(cells.difference.shape)]
    differences = np.concatenate([channels, cells.difference.ravel()])
    cell_errors = cells.standard_error.ravel() * math.sqrt(max(float(correlation[0]), 1.0))
    scores = np.concatenate(
        [_scores(channels, channel_errors, freedom), _scores(cells.difference.ravel(), cell_errors, math.inf)]
    )
    worst = int(np.argmax(np.where(np.isnan(scores), np.inf, scores)))
    return BiasTest(
        difference, error, float(_scores(grey_difference, grey_error, grey_freedom)[0]), float(scores[worst]),
        names[worst], float(differences[worst]),
        (student_score(MEAN_LIMIT, float(grey_freedom[0])) + NormalDist().inv_cdf(POWER)) * error,
    )  # fmt: skip


def _compare_means(
    a: Sequence[FloatArray], b: Sequence[FloatArray]
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Relative differences of channels' means, their standard errors, these errors' degrees of freedom, and variances
    over those of independent pixels."""
    difference, by_pixels = metrics.compare_means(a, b)
    noise_a, noise_b = mean_noise(a), mean_noise(b)
    independent = noise_a.of_pixels + noise_b.of_pixels
    together = noise_a.variance + noise_b.variance
    correlation = np.where(independent > 0.0, together / np.maximum(independent, 1e-300), 1.0)
    return difference, by_pixels * np.sqrt(correlation), joint_freedom(noise_a, noise_b), correlation


def _scores(difference: FloatArray, error: FloatArray, freedom: FloatArray | float) -> FloatArray:
    """Differences in standard errors, as normal scores; what is equal but for rounding counts as equal, even without
    noise."""
    return normal_score(np.abs(difference) / np.maximum(error, 1e-6 + 0.0 * difference), freedom)


def detects(images: Sequence[FloatArray], references: Sequence[FloatArray], bias: float) -> bool:
    """Whether the same pictures with a bias planted in them are found biased."""
    return find_bias([np.asarray(image) * np.float32(1.0 + bias) for image in images], references).is_biased


def variance_ratio(
    images: Sequence[FloatArray], others: Sequence[FloatArray], reference: FloatArray, draws: int = 100
) -> tuple[float, float, float]:
    """Variance of `images` over that of `others`: trimmed, its standard error, and of all pixels.

    Relative variances over seeds (`metrics.seed_variance`), without the worst pixels of each and with them. The
    standard error is by drawing the pixels again (bootstrap, fixed seed); nan for noise-free pictures.
    """
    a = metrics.seed_variance_map(images, reference, 2).ravel()
    b = metrics.seed_variance_map(others, reference, 2).ravel()
    rng = np.random.default_rng(0)

    def ratio(x: FloatArray, y: FloatArray) -> tuple[float, float]:
        top, bottom = metrics.reduce_error(x), metrics.reduce_error(y)
        if bottom.trimmed < 1e-12:
            return (1.0, 1.0) if top.trimmed < 1e-10 else (math.inf, math.inf)
        return top.trimmed / bottom.trimmed, top.whole / bottom.whole

    trimmed, whole = ratio(a, b)
    spread = []
    for _ in range(draws):
        rows = rng.integers(0, a.size, a.size)
        spread.append(ratio(a[rows], b[rows])[0])
    error = float(np.std(spread)) if np.isfinite(spread).all() else math.nan
    return trimmed, error, whole


def worst_pixels(images: Sequence[FloatArray], reference: FloatArray) -> float:
    """Relative squared error against the reference that one pixel in a thousand exceeds, of all pictures together."""
    maps = [metrics.relative_squared_error_map(image, reference) for image in images]
    return float(np.quantile(np.stack(maps), 0.999))
