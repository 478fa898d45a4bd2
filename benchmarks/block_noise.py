# SPDX-License-Identifier: GPL-3.0-or-later
"""How noisy a picture's mean is, whose pixels share their random numbers with neighbours; and Student's t for it.

The pixels of a block of 8 x 8 have one scrambled sequence (`engine.kernels.pixel_shifts`), so that their errors go
together: mostly in opposite directions, at edges in the same. Blocks know nothing of each other, whatever was learned
from all of them: given that, the samples of an iteration are independent and their mean is the pixel's value. So sums
over blocks are the units of which the noise is known. There are few of them: a score is one of Student's t.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from benchmarks.metrics import FloatArray
from engine.kernels.pixel_shifts import PLACE_BITS

#: Side of a block.
BLOCK = 1 << PLACE_BITS // 2


@dataclass(frozen=True)
class MeanNoise:
    """Noise of the mean over seeds and pixels, by channel.

    variance : float64 (channels,)
    freedom : float64 (channels,), degrees of freedom of `variance`
    of_pixels : float64 (channels,), what the variance would be if pixels were independent
    """

    variance: FloatArray
    freedom: FloatArray
    of_pixels: FloatArray


def _block_sums(errors: FloatArray, first_row: int) -> FloatArray:
    """Sums over blocks, of which the first has `first_row` rows."""
    rows = np.unique([0, *range(first_row, errors.shape[1], BLOCK)])
    columns = np.arange(0, errors.shape[2], BLOCK)
    return np.asarray(np.add.reduceat(np.add.reduceat(errors, rows, axis=1), columns, axis=2))


def _noise_of(sums: FloatArray, pixel_count: int) -> tuple[FloatArray, FloatArray]:
    """Variance of the mean, and its degrees of freedom (Satterthwaite 1946), from sums (seeds, ..., channels)."""
    seed_count = len(sums)
    variance = sums.reshape(seed_count, -1, sums.shape[-1]).var(axis=0, ddof=1)
    total = variance.sum(axis=0)
    # A square of an estimate is too large by (n + 1) / (n - 1) for normal noise, n the number of seeds.
    squares = (variance**2).sum(axis=0) / (seed_count + 1)
    freedom = np.where(squares > 0.0, total**2 / np.maximum(squares, 1e-300), np.inf)
    return total / (seed_count * pixel_count**2), freedom


def mean_noise(images: Sequence[FloatArray]) -> MeanNoise:
    """Noise of the mean of independent pictures, float (height, width, channels), two or more.

    Pictures may have their first row at the top or at the bottom, and blocks are counted from the bottom: where the
    height is no multiple of a block's, whatever is the noisier is taken.
    """
    stack = np.stack([np.asarray(image, np.float64) for image in images])
    if len(stack) < 2:
        raise ValueError("standard errors need at least 2 seeds")
    errors = stack - stack.mean(axis=0)
    pixel_count = stack.shape[1] * stack.shape[2]
    starts = {BLOCK, stack.shape[1] % BLOCK or BLOCK}
    found = [_noise_of(_block_sums(errors, first), pixel_count) for first in starts]
    variance, freedom = max(found, key=lambda noise: float(noise[0].sum()))
    return MeanNoise(variance, freedom, _noise_of(errors, pixel_count)[0])


def joint_freedom(a: MeanNoise, b: MeanNoise) -> FloatArray:
    """Degrees of freedom of the sum of two variances (Welch 1947), float64 (channels,)."""
    squares = a.variance**2 / a.freedom + b.variance**2 / b.freedom
    total = (a.variance + b.variance) ** 2
    return np.asarray(np.where(squares > 0.0, total / np.maximum(squares, 1e-300), np.inf))


def normal_score(t: FloatArray | float, freedom: FloatArray | float) -> FloatArray:
    """The normal score that is as likely as Student's `t` >= 0: Wallace 1959, to 1% from 5 degrees of freedom on."""
    nu = np.minimum(freedom, 1e12)
    return np.asarray(
        np.sqrt(nu * np.log1p(np.square(t) / nu)) * ((8.0 * nu + 1.0) / (8.0 * nu + 3.0))
    )


def student_score(z: float, freedom: float) -> float:
    """Student's t that is as likely as a normal score `z`: the inverse of `normal_score`, up to 2% too large."""
    nu = min(freedom, 1e12)
    scaled = z * (8.0 * nu + 3.0) / (8.0 * nu + 1.0)
    return math.sqrt(nu * math.expm1(min(scaled**2 / nu, 700.0)))
