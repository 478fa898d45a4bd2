# SPDX-License-Identifier: GPL-3.0-or-later
"""What is known of the light that the radiance cache lacks, from the few paths that measure it.

Two halves of these paths give two independent images of it, both unbiased and noisy. They are taken apart into bands,
from the whole image down to single pixels. Of each band as much is kept as is known: the product of the halves is on
average the square of what is lacking, the square of their difference that of the noise, and the Wiener weight of the
two is what brings the error down most. With ever more samples the noise goes, every band is kept whole, and their sum
is the measured difference itself: the image converges to the unbiased one (docs/decisions/radiance-cache.md).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

#: Pixels to each side over which the two squares are averaged, and by how much of its own error the signal is taken to
#: be less than it seems: noise must not pass for it.
_WINDOW = 4
_DOUBT = 2.0
#: Bands of details below 8 pixels.
_FINE_BANDS = 3


def _reduce(image: np.ndarray) -> np.ndarray:
    """Means over 2 x 2 pixels; of an odd last row or column over what there is."""
    height, width = image.shape[:2]
    image = np.pad(image, ((0, height % 2), (0, width % 2), (0, 0)), mode="edge")
    return 0.25 * (image[::2, ::2] + image[1::2, ::2] + image[::2, 1::2] + image[1::2, 1::2])


def _expand_axis(image: np.ndarray, size: int) -> np.ndarray:
    """Twice the rows, by linear interpolation, cut to `size`."""
    before = np.concatenate((image[:1], image[:-1]))
    after = np.concatenate((image[1:], image[-1:]))
    twice = np.empty((2 * len(image), *image.shape[1:]), image.dtype)
    twice[::2] = 0.75 * image + 0.25 * before
    twice[1::2] = 0.75 * image + 0.25 * after
    return twice[:size]


def _expand(image: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    """An image of the next larger size, by bilinear interpolation."""
    rows = _expand_axis(image, shape[0])
    return _expand_axis(rows.swapaxes(0, 1), shape[1]).swapaxes(0, 1)


def _box_axis(image: np.ndarray) -> np.ndarray:
    """Means along the first axis over the window, which ends with the image."""
    size = len(image)
    total = np.concatenate((np.zeros_like(image[:1]), np.cumsum(image, axis=0)))
    index = np.arange(size)
    first, last = np.maximum(index - _WINDOW, 0), np.minimum(index + _WINDOW + 1, size)
    return (total[last] - total[first]) / (last - first)[:, None]


def _mean_around(image: np.ndarray) -> np.ndarray:
    """Means over the window of an image without channels."""
    return _box_axis(_box_axis(image.astype(np.float64)).T).T


def _kept(first: np.ndarray, second: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Wiener weight of a band by its two halves, mean square of its true difference as far as they tell (it may be
    negative), and the variance of its noise: float (height, width).
    """
    signal = _mean_around((first * second).mean(axis=-1))
    noise = _mean_around(((first - second) ** 2).mean(axis=-1)) / 4.0
    height, width = signal.shape
    seen = min(2 * _WINDOW + 1, height) * min(2 * _WINDOW + 1, width)
    # Noise alone makes products of this size: those of the halves have twice the variance each.
    sure = np.maximum(signal - _DOUBT * 2.0 * noise / np.sqrt(seen), 0.0)
    return sure / np.maximum(sure + noise, 1e-30), signal, noise


def _bands(sums: np.ndarray, shape: tuple[int, int]) -> list[tuple[np.ndarray, np.ndarray]]:
    """Both halves of each band, the whole image first; each image twice the size of the one before."""
    halves = 2.0 * sums.reshape(*shape, 2, 3)
    images = [(halves[..., 0, :], halves[..., 1, :])]
    while max(images[-1][0].shape[:2]) > 1:
        images.append((_reduce(images[-1][0]), _reduce(images[-1][1])))
    bands = [images[-1]]
    for finer, coarser in zip(images[-2::-1], images[:0:-1], strict=True):
        size = finer[0].shape[:2]
        bands.append((finer[0] - _expand(coarser[0], size), finer[1] - _expand(coarser[1], size)))
    return bands


def _with_band(known: np.ndarray, kept: np.ndarray, first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """What is known of all bands down to one, given that of the bands before it."""
    return _expand(known, kept.shape) + kept[..., None] * (0.5 * (first + second))


def known_residual(sums: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    """As much of the difference between the true image and the cached one as is known.

    Parameters
    ----------
    sums : float32 (P, 6)
        Of a film (`FilmTile.residual`), over the weight of all its samples.
    shape : (int, int)
        Rows and columns of the image.

    Returns
    -------
    float32 (P, 3)
    """
    known = np.zeros((1, 1, 3))
    for first, second in _bands(sums, shape):
        kept, _, _ = _kept(first, second)
        known = _with_band(known, kept, first, second)
    return known.reshape(-1, 3).astype(np.float32)


def with_residual(cached: np.ndarray, sums: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    """The cached image with what is known of what it lacks: float32 (P, 3).

    It is nowhere negative. The true image is not either, so this can only bring the error down.

    Parameters
    ----------
    cached : float32 (P, 3)
    sums, shape : see `known_residual`
    """
    return np.maximum(cached + known_residual(sums, shape), np.float32(0.0))


class ResidualError(NamedTuple):
    """What `known_residual` knows, and errors of an image with it, weighted means over pixels.

    known : float32 (P, 3)
    noise : float, variance that comes with what is known
    bias_squared : float, squares of what is lacking still
    wide_squared, wide_noise : float
        Squares of what was lacking, known by now or not, in bands of 8 pixels and more; the standard error of that.
    """

    known: np.ndarray
    noise: float
    bias_squared: float
    wide_squared: float
    wide_noise: float


def residual_error(sums: np.ndarray, shape: tuple[int, int], weights: np.ndarray) -> ResidualError:
    """What `known_residual` does to the image, estimated.

    Parameters
    ----------
    sums, shape : see `known_residual`
    weights : float32 (P,)
        Of the pixels' squared errors (`engine.ris.orca.pixel_weights`).
    """
    weight = [weights.reshape(*shape, 1)]
    while max(weight[-1].shape[:2]) > 1:
        weight.append(_reduce(weight[-1]))
    known = np.zeros((1, 1, 3))
    total_noise = bias_squared = wide_squared = wide_variance = 0.0
    for index, ((first, second), of_pixel) in enumerate(zip(_bands(sums, shape), reversed(weight), strict=True)):
        kept, signal, noise = _kept(first, second)
        known = _with_band(known, kept, first, second)
        total_noise += float((kept * kept * noise * of_pixel[..., 0]).mean())
        # A band whose true difference is 0 seems to have a negative square as often as a positive one.
        bias_squared += max(float(((1.0 - kept) ** 2 * signal * of_pixel[..., 0]).mean()), 0.0)
        if index < len(weight) - _FINE_BANDS:
            wide_squared += float((signal * of_pixel[..., 0]).mean())
            # Products of two halves that are noise alone: each half has twice the variance of their mean.
            wide_variance += float((2.0 * noise * of_pixel[..., 0]).mean()) ** 2 / signal.size
    return ResidualError(
        known.reshape(-1, 3).astype(np.float32), total_noise, bias_squared, wide_squared, math.sqrt(wide_variance)
    )
