# SPDX-License-Identifier: GPL-3.0-or-later
"""Moments of the samples of each pixel, from the sums of a unit of work."""

import numpy as np

from engine.runtime.jit import kernel


@kernel(fastmath=False)
def add_moments(count, mean, spread, pixels, radiance, square, sample_count):
    """Take a unit's sums (Chan et al. 1983, of two sets of samples).

    Parameters
    ----------
    count : int32 (P,); mean : float32 (P, C); spread : float32 (P,)
        Samples so far, their mean, and the sum of their squared differences from it, averaged over channels.
    pixels : int64 (N,), each once
    radiance, square : float32 (N or more, C), sums over `sample_count` samples
    sample_count : int
    """
    added, width = np.float64(sample_count), mean.shape[1]
    for k in range(len(pixels)):
        pixel = pixels[k]
        before = np.float64(count[pixel])
        share = added / (before + added)
        within, between = np.float64(0.0), np.float64(0.0)
        for c in range(width):
            total = np.float64(radiance[k, c])
            within += max(np.float64(square[k, c]) - total * total / added, np.float64(0.0))
            difference = total / added - np.float64(mean[pixel, c])
            between += difference * difference
            mean[pixel, c] = np.float32(np.float64(mean[pixel, c]) + difference * share)
        spread[pixel] = np.float32(np.float64(spread[pixel]) + (within + before * share * between) / width)
        count[pixel] += sample_count


@kernel(fastmath=False)
def add_weighted(weight, weight_squared, moments, pixels, radiance, square, sample_count):
    """Add a unit's sums, and the weights of its samples, which are one.

    Parameters
    ----------
    weight, weight_squared : float32 (P,)
    moments : float32 (2, P, C)
    pixels, radiance, square, sample_count
        As for `add_moments`.
    """
    for k in range(len(pixels)):
        pixel = pixels[k]
        for c in range(moments.shape[2]):
            moments[0, pixel, c] += radiance[k, c]
            moments[1, pixel, c] += square[k, c]
        weight[pixel] += np.float32(sample_count)
        weight_squared[pixel] += np.float32(sample_count)


@kernel(fastmath=False)
def add_values(weight, total, pixels, radiance, sample_count, factor):
    """Add a unit's sums to those of an image, float32 (P,) and (P, C), times what each of its samples weighs.

    Parameters
    ----------
    pixels, radiance, sample_count
        As for `add_moments`.
    factor : float32
    """
    added = np.float32(sample_count) * factor
    for k in range(len(pixels)):
        pixel = pixels[k]
        for c in range(total.shape[1]):
            total[pixel, c] += radiance[k, c] * factor
        weight[pixel] += added
