# SPDX-License-Identifier: GPL-3.0-or-later
"""A mix of a denoised picture and the one that was sampled, so that denoising does no harm once noise is gone.

A denoiser's own error stays where noise falls with every sample. How far the two pictures differ tells that error, once
it is more than the noise that was taken away. Of noise the samples' variance tells, and how much of it the denoiser
lets through is seen when it denoises the picture again with a little noise more: at thousands of samples most of it.
"""

from __future__ import annotations

import numpy as np

#: Noise that is added to see what the denoiser lets through, over that of the samples.
_ADDED = np.float32(0.5)
#: Times the noise that was taken away that a difference has to exceed: what exceeds it by less may be chance.
_DOUBT = 1.3
#: What of the noise counts as taken away at least.
_LEAST_TAKEN = 0.05
#: Pixels that are mixed at once: what lies between takes more room than the pictures. And rows around that count: the
#: mean of ratios takes one, and what is let through two more.
PIXELS_AT_ONCE = 1 << 18
_REACH = 3
#: The least variance that is divided by, and the largest ratio of a square to it that counts.
_TINY, _MOST = 1e-30, 1e6


def added_noise(color: np.ndarray, variance: np.ndarray) -> np.ndarray:
    """Noise to add to a picture before it is denoised again: float32 (height, width, 3).

    Half a standard deviation, up or down by chance, in all channels of a pixel alike, as light comes; always the same
    for a size. It goes up where there would be light below zero, and is 0 where something is no number.

    Parameters
    ----------
    color : float32 (height, width, 3)
        What is denoised.
    variance : float32 (height, width, 3)
        Of the mean of a pixel's samples.
    """
    with np.errstate(invalid="ignore"):
        size = _ADDED * np.sqrt(variance)
        is_up = np.random.default_rng(0).random(color.shape[:2]) < 0.5
        is_up |= (color < size).any(axis=2)
        added = np.where(is_up[..., None], size, -size)
    is_known = np.isfinite(color).all(axis=2) & np.isfinite(added).all(axis=2)
    return np.where(is_known[..., None], added, np.float32(0.0)).astype(np.float32)


def mixed(
    denoised: np.ndarray, sampled: np.ndarray, variance: np.ndarray, added: np.ndarray, again: np.ndarray
) -> np.ndarray:
    """The denoised picture, with as much of its difference to the samples as noise does not account for.

    The square of that difference is on average the square of the denoiser's error and the variance that was taken
    away. Over that variance it is z, of which 3 x 3 pixels have a mean. The share of the difference that brings the
    error down most is then 1 - 1 / z; it is taken to be 1 - 1.3 / z, and none where that is negative. With ever more
    samples z grows, and the mix converges to the samples, wherever the denoiser errs.

    A pixel counts as no less noisy than the 3 x 3 pixels around it on average: fireflies stay out, and so does what
    surrounds them. What is let through is a mean over 5 x 5 pixels.

    Parameters
    ----------
    denoised : float32 (height, width, 3)
        Scene-linear radiance.
    sampled : float32 (height, width, >= 3)
        What it was made from; further channels are left out.
    variance : float32 (height, width, 3)
        Of the mean of a pixel's samples, in the square of that unit.
    added : float32 (height, width, 3)
        `added_noise`.
    again : float32 (height, width, 3)
        The denoised picture of what `denoised` was made from with that.

    Returns
    -------
    float32 (height, width, 3)
        As denoised where something is no number.

    References
    ----------
    James and Stein 1961, "Estimation with Quadratic Loss": the share, and that it is not negative.
    Stein 1981, "Estimation of the Mean of a Multivariate Normal Distribution": noise that an estimate shares with the
    samples.
    Ramani, Blu and Unser 2008, "Monte-Carlo SURE": that it is seen by adding noise.
    Firmino et al. 2022, "Progressive Denoising of Monte Carlo Rendered Images": mixing by estimated errors.
    """
    height, width = denoised.shape[:2]
    mix = np.empty((height, width, 3), np.float32)
    rows = max(PIXELS_AT_ONCE // max(width, 1), 1)
    for first in range(0, height, rows):
        last = min(first + rows, height)
        low, high = max(first - _REACH, 0), min(last + _REACH, height)
        images = (image[low:high, :, :3] for image in (denoised, sampled, variance, added, again))
        mix[first:last] = _mixed_rows(*images)[first - low : last - low]
    return mix


def _sum_around(image: np.ndarray) -> np.ndarray:
    """Sums over 3 x 3 pixels, outside the picture nothing.

    Each is summed for itself: from running sums (`engine.denoise.windows`) all pixels behind a firefly would have what
    is lost by rounding beside its variance.
    """
    padded = np.pad(image, 1)
    rows = padded[:-2] + padded[1:-1] + padded[2:]
    return np.asarray(rows[:, :-2] + rows[:, 1:-1] + rows[:, 2:])


def _mixed_rows(
    denoised: np.ndarray, sampled: np.ndarray, variance: np.ndarray, added: np.ndarray, again: np.ndarray
) -> np.ndarray:
    """`mixed`, of rows of a picture."""
    is_known = np.ones(denoised.shape[:2], bool)
    for image in (denoised, sampled, variance, again):
        is_known &= np.isfinite(image).all(axis=2)
    difference, change = np.zeros(denoised.shape), np.zeros(denoised.shape)
    difference[is_known] = sampled[is_known].astype(np.float64) - denoised[is_known]
    change[is_known] = again[is_known].astype(np.float64) - denoised[is_known]
    counts = _sum_around(np.ones(is_known.shape))
    noise = np.where(is_known, variance.mean(axis=2, dtype=np.float64), 0.0)
    noise = np.maximum(np.maximum(noise, _sum_around(noise) / counts), _TINY)
    # Relative to the noise, so that what is bright does not decide for what is dark beside it.
    through = _sum_around(_sum_around((added * change).mean(axis=2) / noise))
    whole = _sum_around(_sum_around(np.square(added, dtype=np.float64).mean(axis=2) / noise))
    taken = np.clip(1.0 - through / np.maximum(whole, _TINY), _LEAST_TAKEN, 1.0)
    ratio = np.minimum(np.square(difference).mean(axis=2) / (taken * noise), _MOST)
    over_noise = _sum_around(ratio) / counts
    share = np.where(is_known, 1.0 - _DOUBT / np.maximum(over_noise, _DOUBT), 0.0)
    return (denoised + share[..., None] * difference).astype(np.float32)
