# SPDX-License-Identifier: GPL-3.0-or-later
"""Sums of a unit of work, added to those of the whole film.

Rounded after each product and each sum, as numpy does: no flag lets LLVM join them.
"""

import numpy as np

from engine.runtime.jit import kernel


@kernel(fastmath=False)
def _add_rows(target, pixels, rows, factor):
    if target.shape[0] == 0:
        return
    for k in range(len(pixels)):
        for c in range(target.shape[1]):
            target[pixels[k], c] += rows[k, c] * factor


@kernel(fastmath=False)
def _add_numbers(target, pixels, numbers, factor):
    if target.shape[0] == 0:
        return
    for k in range(len(pixels)):
        target[pixels[k]] += numbers[k] * factor


@kernel(fastmath=False)
def add_sums(film, pixels, tile, factor):
    """Add rows of `tile` to pixels of `film`, both `FilmTile`, times a factor; all columns but points and mattes.

    Parameters
    ----------
    pixels : int64 (N,), each once
    factor : float32
        Weight of each of the samples.
    """
    squared = factor * factor
    _add_rows(film.radiance, pixels, tile.radiance, factor)
    _add_rows(film.square, pixels, tile.square, factor)
    _add_rows(film.features, pixels, tile.features, factor)
    _add_rows(film.residual, pixels, tile.residual, factor)
    _add_rows(film.half, pixels, tile.half, factor)
    _add_rows(film.denoising, pixels, tile.denoising, factor)
    _add_rows(film.light, pixels, tile.light, factor)
    _add_rows(film.caught, pixels, tile.caught, factor)
    _add_rows(film.data, pixels, tile.data, factor)
    _add_numbers(film.alpha, pixels, tile.alpha, factor)
    _add_numbers(film.residual_square, pixels, tile.residual_square, squared)
    _add_numbers(film.square_gain, pixels, tile.square_gain, factor)
    _add_numbers(film.ended, pixels, tile.ended, factor)
    _add_numbers(film.half_weight, pixels, tile.half_weight, factor)
    for k in range(len(pixels)):
        pixel, count = pixels[k], np.float64(tile.count[k])
        film.weight[pixel] = np.float32(np.float64(film.weight[pixel]) + count * np.float64(factor))
        film.weight_squared[pixel] = np.float32(np.float64(film.weight_squared[pixel]) + count * np.float64(squared))
        film.count[pixel] += tile.count[k]
