# SPDX-License-Identifier: GPL-3.0-or-later
"""What is known of the light that the radiance cache lacks, from the few paths that measure it.

Two halves of these paths give two independent images of it, both unbiased and noisy. They are taken apart into bands,
from the whole image down to single pixels. Of each band as much is kept as is known: the product of the halves is on
average the square of what is lacking, the squares of single paths tell the noise, and the Wiener weight of the two is
what brings the error down most. Bands whose noise is small beside that of the cached image are kept whole, or nearly
so, whether anything is sure of them or not: nobody sees what that costs, and what they lack may be too little to be
sure of, but of one sign over many pixels. With ever more samples the noise goes, every band is kept whole, and their
sum is the measured difference itself: the image converges to the unbiased one (docs/decisions/radiance-cache.md).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from engine.guiding.models.kept_mean import kept_share, sure_mean, with_mean
from engine.ris.orca import pixel_weights, sample_variance
from engine.state.film import FilmTile

#: Pixels to each side over which the two squares are averaged, and by how much of its own error the signal is taken to
#: be less than it seems: noise must not pass for it.
_WINDOW = 4
_DOUBT = 2.0
#: Noise that a band may always bring, as a share of that of the cached image. Wider bands bring a quarter each of the
#: next finer ones' noise: in all it is a third more at most.
_FREE_NOISE = 0.1
#: The same of the mean of a denoised picture, which has a tenth of the noise or less.
_FREE_NOISE_DENOISED = 0.01
#: Percentage of the pixels whose noise is cut to the next smaller one's.
_CUT_PERCENT = 0.1
#: What is added to the image that differences are relative to, as a share of its mean.
_LEAST_SHARE = np.float32(0.01)
#: The brightest mean whose square has room in float32, and the least sum of weights that is divided by.
_BRIGHTEST = np.float32(1e18)
_LEAST_WEIGHT = np.float32(1e-18)
#: Bands of details below 8 pixels.
_FINE_BANDS = 3


class OwnNoise(NamedTuple):
    """The cached image's own noise, float32 (P,): variances of its pixels, weighted, and these weights.

    Weights are those of squared errors (`engine.ris.orca.pixel_weights`): what is little beside a bright pixel's noise
    may be much in the dark beside it. The largest weighted variances are cut: single bright paths would let in all.
    """

    weighted: np.ndarray
    weight: np.ndarray


def cached_noise(sums: FilmTile, shape: tuple[int, int]) -> OwnNoise:
    """Noise of a cached image of these rows and columns.

    Parameters
    ----------
    sums : FilmTile
    shape : (int, int)
    """
    total = np.maximum(sums.weight, _LEAST_WEIGHT)
    mean = np.clip(sums.radiance / total[:, None], -_BRIGHTEST, _BRIGHTEST)
    square = np.minimum(sums.square / total[:, None], _BRIGHTEST * _BRIGHTEST)
    weight = pixel_weights(mean.reshape(*shape, -1))
    weighted = sample_variance(mean, square) * (sums.weight_squared / (total * total)) * weight
    return OwnNoise(np.minimum(weighted, np.percentile(weighted, 100.0 - _CUT_PERCENT)).astype(np.float32), weight)


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


def _kept(
    first: np.ndarray, second: np.ndarray, variance: np.ndarray, weighted: np.ndarray, weight: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """How much of a band is kept, by its two halves and the variance of their mean in each pixel.

    A bright path in one pixel is noise there, and makes nothing certain of its neighbours: the Wiener weight is by the
    pixel's own variance where that is more than the window's, and the window's mean square is sure as far as the
    squares of the variances tell. A pixel whose paths happen to have found nothing is no surer than those around it.

    Parameters
    ----------
    first, second : float (height, width, 3)
    variance : float (height, width, 1)
    weighted, weight : float (height, width, 1)
        Of `OwnNoise`, means over the pixels that one of the band stands for.

    Returns
    -------
    kept, signal, lacking : float (height, width)
        The weight, the mean square of the band's true difference as far as is known (it may be negative), and the mean
        square of what is surely there and not kept.
    """
    of_pixel = variance[..., 0]
    noise = np.maximum(of_pixel, _mean_around(of_pixel))
    signal = _mean_around((first * second).mean(axis=-1))
    height, width = signal.shape
    seen = min(2 * _WINDOW + 1, height) * min(2 * _WINDOW + 1, width)
    # Noise alone makes products of this size: each of the halves has twice the variance of their mean.
    of_noise = 2.0 * np.sqrt(_mean_around(of_pixel * of_pixel) / seen)
    sure = np.maximum(signal - _DOUBT * of_noise, 0.0)
    own = _mean_around(weighted[..., 0]) / np.maximum(_mean_around(weight[..., 0]), 1e-30)
    kept = kept_share(sure, noise, _FREE_NOISE * own)
    return kept, signal, (1.0 - kept) ** 2 * sure


class _Band(NamedTuple):
    """Both halves of a band, float (height, width, 3), the variance of their mean, and means of `OwnNoise`, float
    (height, width, 1).
    """

    first: np.ndarray
    second: np.ndarray
    variance: np.ndarray
    weighted: np.ndarray
    weight: np.ndarray


def _bands(sums: np.ndarray, variance: np.ndarray, own: OwnNoise | None, shape: tuple[int, int]) -> list[_Band]:
    """Bands, the whole image first; each image twice the size of the one before.

    A band has a little less variance than the image that it is taken from, which is left out of account.
    """
    halves = 2.0 * sums.reshape(*shape, 2, 3)
    nothing = np.zeros_like(variance)
    others = [one.reshape(*shape, 1) for one in (variance, *(own or OwnNoise(nothing, nothing)))]
    images = [_Band(halves[..., 0, :], halves[..., 1, :], *others)]
    while max(images[-1].variance.shape[:2]) > 1:
        coarser = _Band(*(_reduce(one) for one in images[-1]))
        images.append(coarser._replace(variance=0.25 * coarser.variance))
    bands = [images[-1]]
    for finer, coarser in zip(images[-2::-1], images[:0:-1], strict=True):
        size = finer.variance.shape[:2]
        first, second = finer.first - _expand(coarser.first, size), finer.second - _expand(coarser.second, size)
        bands.append(finer._replace(first=first, second=second))
    return bands


def _with_band(known: np.ndarray, kept: np.ndarray, band: _Band) -> np.ndarray:
    """What is known of all bands down to one, given that of the bands before it."""
    return _expand(known, kept.shape) + kept[..., None] * (0.5 * (band.first + band.second))


def known_residual(
    sums: np.ndarray, variance: np.ndarray, shape: tuple[int, int], own: OwnNoise | None = None
) -> np.ndarray:
    """As much of the difference between the true image and the cached one as is known.

    Parameters
    ----------
    sums : float32 (P, 6)
        Sums of a film (`FilmTile.residual`), over the weight of all its samples.
    variance : float32 (P,)
        Variance of what `sums` says in all (`FilmTile.residual_square`, over the squared weight of all samples).
    shape : (int, int)
        Rows and columns of the image.
    own : OwnNoise, optional
        Of the cached image; None: nothing of a band is kept but what is sure.

    Returns
    -------
    float32 (P, 3)
    """
    known = np.zeros((1, 1, 3))
    for band in _bands(sums, variance, own, shape):
        known = _with_band(known, _kept(*band)[0], band)
    return known.reshape(-1, 3).astype(np.float32)


def _with_mean_of(
    whole: np.ndarray, cached: np.ndarray, sums: np.ndarray, variance: np.ndarray, cells_light: np.ndarray,
    free_noise: float,
) -> np.ndarray:
    """`whole` with the mean over pixels of the cached image with all that it lacks, as far as that is sure."""
    lacks = sums.mean(axis=0, dtype=np.float64)
    mean = cached.mean(axis=0, dtype=np.float64) + lacks[:3] + lacks[3:]
    noise = float(variance.mean(dtype=np.float64)) / len(variance)
    return with_mean(whole, sure_mean(whole, mean, noise, free_noise), cells_light)


def _smooth(ended: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    """Light of cells by pixel, of which a pixel's few measuring paths say little alone."""
    return _mean_around(ended.reshape(shape)).ravel()


def _over_image(
    image: np.ndarray, sums: np.ndarray, variance: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """What differences are taken over: the image, but nowhere near 0; and `sums` and `variance` over that."""
    scale = np.maximum(image + _LEAST_SHARE * image.mean(), np.float32(1e-12))
    return scale, sums / np.concatenate((scale, scale), axis=1), variance / (scale * scale).mean(axis=1)


def with_relative_residual(
    denoised: np.ndarray, sums: np.ndarray, variance: np.ndarray, ended: np.ndarray, shape: tuple[int, int],
    own: OwnNoise,
) -> np.ndarray:
    """The denoised cached image with what is known of what it lacks: float32 (P, 3), nowhere negative.

    Bands are those of the difference over the denoised image: what is known only in wide bands then follows the image's
    edges, and does not light what is dark beside something bright. With ever more samples every band is kept whole here
    too, and the sum is the measured difference.

    Parameters
    ----------
    denoised : float32 (P, 3)
    ended : float32 (P,)
        Light that paths ended with, mean over channels (`FilmTile.ended`, over the weight of all samples).
    sums, variance, shape : see `known_residual`
    own : OwnNoise
        Of the cached image before it was denoised.
    """
    scale, relative, relative_variance = _over_image(denoised, sums, variance)
    known = known_residual(relative, relative_variance, shape)
    whole = np.maximum(denoised + known * scale, np.float32(0.0))
    free_noise = _FREE_NOISE_DENOISED * float(own.weighted.mean())
    return _with_mean_of(whole, denoised, sums, variance, _smooth(ended, shape), free_noise)


def halves_with_relative_residual(
    denoised: tuple[np.ndarray, np.ndarray], sums: np.ndarray, variance: np.ndarray, shape: tuple[int, int]
) -> tuple[np.ndarray, np.ndarray]:
    """As `with_relative_residual`, of two halves: each with what one half of the measuring paths says.

    Bands are kept as all measuring paths have it, and the mean is left as it is.

    Parameters
    ----------
    denoised : two of float32 (P, 3)
        Of halves of the samples.
    sums, variance, shape : see `known_residual`
    """
    scale, relative, relative_variance = _over_image(np.float32(0.5) * (denoised[0] + denoised[1]), sums, variance)
    found = residual_noise(relative, relative_variance, shape)
    first = denoised[0] + (found.known - found.difference) * scale
    second = denoised[1] + (found.known + found.difference) * scale
    return np.maximum(first, np.float32(0.0)), np.maximum(second, np.float32(0.0))


def with_residual(
    cached: np.ndarray, sums: np.ndarray, variance: np.ndarray, ended: np.ndarray, shape: tuple[int, int],
    own: OwnNoise,
) -> np.ndarray:
    """The cached image with what is known of what it lacks: float32 (P, 3).

    Its mean is that of the cached image with all that measuring paths found, as far as single paths do not decide it
    (`engine.guiding.models.kept_mean`).

    It is nowhere negative: the true image is not either, so this can only bring the error down. Where the cached image
    shows light below zero, as of a lamp of negative strength, the true image has such light too, and nothing is cut:
    the mean would be too bright.

    Parameters
    ----------
    cached : float32 (P, 3)
    ended : see `with_relative_residual`
    sums, variance, shape, own : see `known_residual`
    """
    whole = cached + known_residual(sums, variance, shape, own)
    if not (cached < 0.0).any():
        whole = np.maximum(whole, np.float32(0.0))
    free_noise = _FREE_NOISE * float(own.weighted.mean())
    return _with_mean_of(whole, cached, sums, variance, _smooth(ended, shape), free_noise)


class ResidualNoise(NamedTuple):
    """What `known_residual` knows, and how well.

    known : float32 (P, 3)
    difference : float32 (P, 3)
        By how much `known` is more than what the first half of the paths alone would say, each band kept alike.
    lacking : float32 (P,), root mean square over channels of what is surely there and not kept
    """

    known: np.ndarray
    difference: np.ndarray
    lacking: np.ndarray


def residual_noise(
    sums: np.ndarray, variance: np.ndarray, shape: tuple[int, int], own: OwnNoise | None = None
) -> ResidualNoise:
    """What is known, its noise, and what is not known, by pixel.

    Parameters
    ----------
    sums, variance, shape, own : see `known_residual`
    """
    known, difference, squared = np.zeros((1, 1, 3)), np.zeros((1, 1, 3)), np.zeros((1, 1, 1))
    for band in _bands(sums, variance, own, shape):
        kept, _, lacking = _kept(*band)
        known = _with_band(known, kept, band)
        difference = _expand(difference, kept.shape) + kept[..., None] * (0.5 * (band.second - band.first))
        squared = _expand(squared, kept.shape) + lacking[..., None]
    return ResidualNoise(
        known.reshape(-1, 3).astype(np.float32), difference.reshape(-1, 3).astype(np.float32),
        np.sqrt(squared).ravel().astype(np.float32),
    )


class ResidualError(NamedTuple):
    """What `known_residual` knows, and errors of an image with it, weighted means over pixels.

    known : float32 (P, 3)
    noise : float, variance that comes with what is known
    bias_squared, bias_noise : float, squares of what is lacking still; the standard error of that
    wide_squared, wide_noise : float
        Squares of what was lacking, known by now or not, in bands of 8 pixels and more; the standard error of that.
    """

    known: np.ndarray
    noise: float
    bias_squared: float
    bias_noise: float
    wide_squared: float
    wide_noise: float


def residual_error(
    sums: np.ndarray, variance: np.ndarray, shape: tuple[int, int], weights: np.ndarray,
    own: OwnNoise | None = None,
) -> ResidualError:
    """What `known_residual` does to the image, estimated.

    Parameters
    ----------
    sums, variance, shape, own : see `known_residual`
    weights : float32 (P,)
        Weights of the pixels' squared errors (`engine.ris.orca.pixel_weights`).
    """
    weight = [weights.reshape(*shape, 1)]
    while max(weight[-1].shape[:2]) > 1:
        weight.append(_reduce(weight[-1]))
    known = np.zeros((1, 1, 3))
    total_noise = bias_squared = bias_variance = wide_squared = wide_variance = 0.0
    for index, (band, of_pixel) in enumerate(
        zip(_bands(sums, variance, own, shape), reversed(weight), strict=True)
    ):
        kept, signal, _ = _kept(*band)
        noise = band.variance[..., 0]
        known = _with_band(known, kept, band)
        total_noise += float((kept * kept * noise * of_pixel[..., 0]).mean())
        lacking = (1.0 - kept) ** 2 * of_pixel[..., 0]
        # Products of two halves that are noise alone: each half has twice the variance of their mean.
        of_noise = 2.0 * noise * of_pixel[..., 0]
        # A band whose true difference is 0 seems to have a negative square as often as a positive one.
        bias_squared += max(float((lacking * signal).mean()), 0.0)
        bias_variance += float(((1.0 - kept) ** 4 * of_noise * of_noise).mean()) / signal.size
        if index < len(weight) - _FINE_BANDS:
            wide_squared += float((signal * of_pixel[..., 0]).mean())
            wide_variance += float((of_noise * of_noise).mean()) / signal.size
    return ResidualError(
        known.reshape(-1, 3).astype(np.float32), total_noise, bias_squared, math.sqrt(bias_variance), wide_squared,
        math.sqrt(wide_variance),
    )
