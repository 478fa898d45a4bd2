# SPDX-License-Identifier: GPL-3.0-or-later
"""Sums over square windows around every pixel, of several sizes for the price of one."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

Float64Array = np.ndarray[tuple[int, ...], np.dtype[np.float64]]


def window_sums(image: np.ndarray, most: int) -> Callable[[int], Float64Array]:
    """Sums over the pixels up to `reach` to each side, for any reach up to `most`; outside the picture is nothing.

    Parameters
    ----------
    image : (height, width, channels)

    Returns
    -------
    callable
        reach -> float64 (height, width, channels)
    """
    height, width = image.shape[:2]
    sums = np.pad(image, ((most + 1, most), (most + 1, most), (0, 0))).cumsum(axis=0, dtype=np.float64).cumsum(axis=1)

    def of(reach: int) -> Float64Array:
        low, high = most - reach, most + 1 + reach
        bands = sums[high : high + height] - sums[low : low + height]
        return np.asarray(bands[:, high : high + width] - bands[:, low : low + width])

    return of


def window_means(image: np.ndarray, reach: int) -> np.ndarray:
    """Means over those of the pixels up to `reach` to each side that there are: float32 (height, width, channels)."""
    ones = np.ones((*image.shape[:2], 1), np.float32)
    return (window_sums(image, reach)(reach) / window_sums(ones, reach)(reach)).astype(np.float32)
