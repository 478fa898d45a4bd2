# SPDX-License-Identifier: GPL-3.0-or-later
"""Cutting fireflies before a picture is denoised: a filter makes a bright blotch of each."""

from __future__ import annotations

import numpy as np

#: Pixels to each side that say how bright a pixel may be.
_REACH = 2
#: What counts of them is the third brightest, so that two fireflies side by side do not excuse each other.
_RANK = 3
#: How many times as bright as that a pixel may be.
_TIMES = 4.0
#: Standard deviations of a pixel's mean below which what it shows is taken to be there.
_SURE = 2.0
#: What may be lost of the picture's light. Where fireflies bring more, they are how light is found there.
_MOST_LOST = 0.01
#: Least albedo that brightness is relative to.
_LEAST_ALBEDO = np.float32(0.05)


def _third_brightest(image: np.ndarray) -> np.ndarray:
    """The third brightest of the 24 pixels around each, float32 (height, width); inf where there are fewer than 3."""
    height, width = image.shape
    padded = np.pad(image, _REACH, constant_values=-np.inf)
    brightest = [np.full_like(image, -np.inf) for _ in range(_RANK)]
    for row in range(2 * _REACH + 1):
        for column in range(2 * _REACH + 1):
            if row == column == _REACH:
                continue
            rest = padded[row : row + height, column : column + width]
            for rank, known in enumerate(brightest):
                brightest[rank], rest = np.maximum(known, rest), np.minimum(known, rest)
    return np.where(brightest[-1] == -np.inf, np.float32(np.inf), brightest[-1])


def without_fireflies(color: np.ndarray, variance: np.ndarray, albedo: np.ndarray | None = None) -> np.ndarray:
    """A picture whose fireflies are no brighter than what is around them has it.

    A firefly is a pixel four times as bright as the third brightest of the 24 around it, both relative to their
    albedos, and not surely so: what lies two standard deviations below it stays. A lamp, or a highlight that most
    samples find, is sure after few samples; with ever more of them everything is, and nothing is cut. Nor is it where
    fireflies bring more than a hundredth of the picture's light: each is cut by less then, so that no more is lost.

    Parameters
    ----------
    color : float32 (height, width, >= 3)
        Scene-linear radiance; further channels are left out.
    variance : float32 (height, width, 3)
        Of the pixel's mean, in the square of that unit.
    albedo : float32 (height, width, >= 3), optional
        Light that is seen directly counts as albedo.

    Returns
    -------
    float32 (height, width, 3)
        Hues stay. What is cut is lost: shared out again it would make the blotches that this avoids
        (docs/decisions/denoising.md).
    """
    seen = np.ascontiguousarray(color[..., :3], np.float32)
    if seen.size == 0:
        return seen
    # What is no number is left for the denoiser.
    with np.errstate(over="ignore", invalid="ignore"):
        brightness, noise = seen.mean(axis=2), np.sqrt(variance[..., :3].mean(axis=2))
        if albedo is not None:
            per_albedo = 1.0 / np.maximum(albedo[..., :3].mean(axis=2), _LEAST_ALBEDO)
            brightness, noise = brightness * per_albedo, noise * per_albedo
        around = np.float32(_TIMES) * _third_brightest(brightness)
        most = np.maximum(np.maximum(around, brightness - np.float32(_SURE) * noise), 0.0)
        is_cut = np.isfinite(brightness) & (brightness > most)
    lost = np.zeros_like(brightness)
    lost[is_cut] = 1.0 - most[is_cut] / brightness[is_cut]
    light = np.where(np.isfinite(seen).all(axis=2), np.abs(seen).sum(axis=2, dtype=np.float64), 0.0)
    allowed = _MOST_LOST * light.sum() / max(float((lost * light).sum()), 1e-30)
    return seen * (1.0 - np.float32(min(allowed, 1.0)) * lost)[..., None]
