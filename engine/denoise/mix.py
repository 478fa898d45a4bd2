# SPDX-License-Identifier: GPL-3.0-or-later
"""A mix of a denoised picture and the one that was sampled, so that denoising does no harm once noise is gone.

A denoiser's own error stays where noise falls with every sample. How far the two pictures differ tells that error, once
it is more than the noise that the samples are known to have.
"""

from __future__ import annotations

import numpy as np

#: Times the noise that a difference has to exceed: what exceeds it by less may be chance.
_DOUBT = 1.3
#: Pixels that are mixed at once: what lies between takes more room than the pictures.
_PIXELS_AT_ONCE = 1 << 18
#: The least variance that is divided by, and the largest ratio of a square to it that counts.
_TINY, _MOST = 1e-30, 1e6


def mixed(denoised: np.ndarray, sampled: np.ndarray, variance: np.ndarray) -> np.ndarray:
    """The denoised picture, with as much of its difference to the samples as noise does not account for.

    The square of that difference is on average the square of the denoiser's error and the samples' variance. Over the
    variance it is z, of which 3 x 3 pixels have a mean. The share of the difference that brings the error down most is
    then 1 - 1 / z; it is taken to be 1 - 1.3 / z, and none where that is negative. With ever more samples z grows, and
    the mix converges to the samples, wherever the denoiser errs.

    A pixel counts as no less noisy than the 3 x 3 pixels around it on average: fireflies stay out, and so does what
    surrounds them.

    Parameters
    ----------
    denoised : float32 (height, width, 3)
        Scene-linear radiance.
    sampled : float32 (height, width, >= 3)
        What it was made from; further channels are left out.
    variance : float32 (height, width, 3)
        Of the mean of a pixel's samples, in the square of that unit.

    Returns
    -------
    float32 (height, width, 3)
        As denoised where something is no number.

    References
    ----------
    James and Stein 1961, "Estimation with Quadratic Loss": the share, and that it is not negative.
    Firmino et al. 2022, "Progressive Denoising of Monte Carlo Rendered Images": mixing by estimated errors.
    """
    height, width = denoised.shape[:2]
    mix = np.empty((height, width, 3), np.float32)
    rows = max(_PIXELS_AT_ONCE // max(width, 1), 1)
    for first in range(0, height, rows):
        last = min(first + rows, height)
        # A ratio takes the pixels around, and a mean of ratios those around them.
        low, high = max(first - 2, 0), min(last + 2, height)
        some = _mixed_rows(denoised[low:high], sampled[low:high, :, :3], variance[low:high])
        mix[first:last] = some[first - low : last - low]
    return mix


def _sum_around(image: np.ndarray) -> np.ndarray:
    """Sums over 3 x 3 pixels, outside the picture nothing.

    Each is summed for itself: from running sums (`engine.denoise.windows`) all pixels behind a firefly would have what
    is lost by rounding beside its variance.
    """
    padded = np.pad(image, 1)
    rows = padded[:-2] + padded[1:-1] + padded[2:]
    return np.asarray(rows[:, :-2] + rows[:, 1:-1] + rows[:, 2:])


def _mixed_rows(denoised: np.ndarray, sampled: np.ndarray, variance: np.ndarray) -> np.ndarray:
    """`mixed`, of rows of a picture."""
    is_known = np.isfinite(denoised).all(axis=2) & np.isfinite(sampled).all(axis=2) & np.isfinite(variance).all(axis=2)
    difference = np.zeros(denoised.shape, np.float64)
    difference[is_known] = sampled[is_known].astype(np.float64) - denoised[is_known]
    counts = _sum_around(np.ones(is_known.shape))
    noise = np.where(is_known, variance.mean(axis=2, dtype=np.float64), 0.0)
    noise = np.maximum(np.maximum(noise, _sum_around(noise) / counts), _TINY)
    over_noise = _sum_around(np.minimum(np.square(difference).mean(axis=2) / noise, _MOST)) / counts
    share = np.where(is_known, 1.0 - _DOUBT / np.maximum(over_noise, _DOUBT), 0.0)
    return (denoised + share[..., None] * difference).astype(np.float32)
