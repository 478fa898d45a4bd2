# SPDX-License-Identifier: GPL-3.0-or-later
"""The mean of a picture with a radiance cache, whatever is kept of what it lacks.

What is known of a band is kept as far as it is sure, and no pixel becomes less than black. Both favour bright paths:
a band that a few of them make sure is kept, one that lacks them is not; and what is cut at black is never taken from
elsewhere. So the picture would be too bright on average, or too dark where little is sure. But of its mean over all
pixels measuring paths know as much as anybody: its noise is that of a pixel, divided by how many there are. That is why
it is kept whole, from the first sample on, and cells' light is made brighter or darker everywhere by the same share.

Where a single path brings as much light as all others, the mean is as noisy as that path, and the whole picture would
be as bright as it says. Such a mean is kept as far as it is sure, or its noise is not seen beside that of the pixels
(docs/decisions/radiance-cache.md).
"""

from __future__ import annotations

import math

import numpy as np

_TINY = 1e-30
#: Squared standard errors that a change of the mean is taken to be less than it seems. Of one path it seems to be one.
_DOUBT = 4.0


def kept_share(
    sure: np.ndarray | float, noise: np.ndarray | float, free_noise: np.ndarray | float
) -> np.ndarray:
    """How much is kept of what was measured: the Wiener weight, or all that brings no more than a free noise.

    Parameters
    ----------
    sure : float
        Square of what is surely there.
    noise, free_noise : float
        Variance of what was measured, and one that may come with it whatever it says.
    """
    free = np.minimum(free_noise / np.maximum(noise, _TINY), 1.0)
    return np.asarray(np.maximum(sure / np.maximum(sure + noise, _TINY), free))


def sure_mean(image: np.ndarray, mean: np.ndarray, noise: float, free_noise: float) -> np.ndarray:
    """The mean that the image is to have: the one that was measured, as far as that may be believed.

    Parameters
    ----------
    image : float (P, 3)
    mean : float (3,)
        As measured.
    noise : float
        Variance of that, mean over channels.
    free_noise : float
        Variance that the mean may have whatever it says, over its square: little beside the noise of the pixels.

    Returns
    -------
    float (3,)
        With ever more samples the noise goes, and it is the measured one.
    """
    now = image.mean(axis=0, dtype=np.float64)
    change = mean - now
    sure = max(float(np.square(change).mean()) - _DOUBT * noise, 0.0)
    return np.asarray(now + kept_share(sure, noise, free_noise * float(np.square(now).mean())) * change)


def _spread(
    image: np.ndarray, change: np.ndarray, weight: np.ndarray, limits: tuple[float, float]
) -> tuple[np.ndarray, np.ndarray]:
    """Change the mean in proportion to weights, as many times these as limits allow; and what is left to change."""
    whole = weight.mean(axis=0, dtype=np.float64)
    factor = np.clip(np.where(whole > 0.0, change / np.maximum(whole, _TINY), 0.0), *limits)
    return image + weight * factor, change - factor * whole


def with_mean(image: np.ndarray, mean: np.ndarray, cells_light: np.ndarray) -> np.ndarray:
    """The image, its light of cells brighter or darker, so that it has another mean: float32 (P, 3).

    Where cells' light would have to be more than twice what it is, or nothing, cells tell little of where light is: the
    rest goes in proportion to the image.

    Parameters
    ----------
    image : float32 (P, 3)
    mean : float (3,)
        What its mean over pixels is to be.
    cells_light : float (P,)
        Mean over channels of the light that paths ended with; it may be more than the image has, or rough.

    Returns
    -------
    float32 (P, 3)
        Nowhere negative where `image` is not: of a mean that only so could be had, as much as is possible.
    """
    size = np.abs(image)
    share = np.minimum(np.abs(cells_light) / np.maximum(size.mean(axis=1), _TINY), 1.0)
    change = mean - image.mean(axis=0, dtype=np.float64)
    least = -math.inf if (image < 0.0).any() else -1.0
    mended, change = _spread(image, change, size * share[:, None], (-1.0, 1.0))
    mended, _ = _spread(mended, change, np.abs(mended), (least, math.inf))
    return np.asarray(mended, np.float32)
