# SPDX-License-Identifier: GPL-3.0-or-later
"""Images at a part of their size, for scenes that limit the size of textures."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from engine.scene.image import Image, associate, is_multiplied

#: Rows of the smaller image that are made at a time.
_ROWS = 64


def reduction(width: int, height: int, limit: int, resolution: float = 1.0) -> int:
    """By what an image's sides are to be divided: a power of two, as in Cycles.

    Parameters
    ----------
    limit : int
        Most texels along either side; 0 = no limit.
    resolution : float
        Share of its size that an image is to have at most.
    """
    factor = 1
    longest = max(width, height)
    while (limit > 0 and longest > limit * factor) or 1.0 > resolution * factor > 0.0:
        factor *= 2
    return factor


def reduced(image: Image, factor: int) -> Image:
    """An image whose texels are means of `factor` x `factor` ones; what is left over at its right and top is cut off.

    Where colours will be multiplied by alpha they are before, so that what is transparent does not bleed.
    """
    if factor == 1:
        return image
    pixels, associates = image.pixels, is_multiplied(image) and not image.is_associated
    height, width = (max(size // factor, 1) for size in pixels.shape[:2])
    result = np.empty_like(pixels, shape=(height, width, 4))
    for first in range(0, height, _ROWS):
        last = min(first + _ROWS, height)
        rows = pixels[first * factor : last * factor]
        if associates:
            rows = rows.copy()
            associate(rows)
        result[first:last] = _means(rows, last - first, width, factor)
    return replace(image, pixels=result, is_associated=image.is_associated or associates)


def _means(rows: np.ndarray, height: int, width: int, factor: int) -> np.ndarray:
    """Means of blocks; those of an image smaller than a block are over all that it has."""
    down, across = min(factor, rows.shape[0] // height), min(factor, rows.shape[1] // width)
    blocks = rows[: height * down, : width * across].reshape(height, down, width, across, 4)
    means = blocks.mean(axis=(1, 3), dtype=np.float32)
    return np.floor(means + 0.5) if rows.dtype == np.uint8 else means
