# SPDX-License-Identifier: GPL-3.0-or-later
"""Errors of rendered images: plain numpy over float arrays, nothing about Blender.

Two kinds of figures, never to be mixed up:

- *against a reference*: `relative_squared_error`, `percentage_error`, `flip`; they hold the noise of both
  images and any bias;
- *from independent seeds*: `seed_variance`; the expected squared error of one render about its own mean. It sees no
  bias and needs no converged reference, only a moderately good one for the denominator.

Images are divided by the reference's mean first, so that dark scenes count like bright ones, and squared errors by
r^2 + 0.01. The trimmed figures leave out the worst 0.1% of pixels, which carry nearly all of it on scenes
with caustics. Pixels in which a reference is NaN are not known (`benchmarks.light_tracing`), and no figure has them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from benchmarks.picture_means import FloatArray, PictureMeans, picture_means

EPSILON = 0.01
TRIMMED_FRACTION = 0.001
#: Darkest cell that differences are relative to, as a share of the image's mean.
CELL_FLOOR = 0.05


@dataclass(frozen=True)
class Error:
    """A relative squared error over an image: of all pixels, and without the worst `TRIMMED_FRACTION` of them."""

    whole: float
    trimmed: float


def _colour(image: FloatArray) -> npt.NDArray[np.float64]:
    return np.asarray(image, np.float64)[..., :3]


def known_pixels(reference: FloatArray) -> npt.NDArray[np.bool_]:
    """Where a reference says something, bool (height, width)."""
    return np.asarray(~np.isnan(_colour(reference)).any(axis=-1))


def image_scale(reference: FloatArray) -> float:
    """Mean of what is known of a reference over pixels and colour channels, 1 for a black one."""
    mean = float(_colour(reference)[known_pixels(reference)].mean())
    return mean if mean > 0.0 else 1.0


def reduce_error(per_pixel: FloatArray) -> Error:
    """Mean and trimmed mean of errors per pixel; the count left out is rounded up, so it is at least one."""
    flat = np.sort(np.asarray(per_pixel, np.float64), axis=None)
    left_out = min(int(np.ceil(flat.size * TRIMMED_FRACTION)), flat.size - 1)
    return Error(float(flat.mean()), float(flat[: flat.size - left_out].mean()))


def relative_squared_error_map(image: FloatArray, reference: FloatArray) -> npt.NDArray[np.float64]:
    """(x - r)^2 / (r^2 + 0.01) per pixel, mean over RGB, both divided by the mean of r; float64 (height, width)."""
    scale = image_scale(reference)
    x, r = _colour(image) / scale, _colour(reference) / scale
    return np.asarray(((x - r) ** 2 / (r**2 + EPSILON)).mean(axis=-1))


def relative_squared_error(image: FloatArray, reference: FloatArray) -> Error:
    """Relative squared error against a reference (its own noise included)."""
    return reduce_error(relative_squared_error_map(image, reference)[known_pixels(reference)])


def seed_variance_map(
    images: Sequence[FloatArray], reference: FloatArray, least_seeds: int = 3
) -> npt.NDArray[np.float64]:
    """Unbiased variance over independent seeds divided by r^2 + 0.01, mean over RGB; float64 (height, width).

    Raises
    ------
    ValueError
        For fewer than `least_seeds` images. Two are unbiased too, but say nothing of their own spread, and what
        trimming leaves out is then mostly luck.
    """
    if len(images) < max(least_seeds, 2):
        raise ValueError(f"seed variance from {len(images)} images: render at least {max(least_seeds, 2)} seeds")
    scale = image_scale(reference)
    stack = np.stack([_colour(image) for image in images]) / scale
    r = _colour(reference) / scale
    return np.asarray((stack.var(axis=0, ddof=1) / (r**2 + EPSILON)).mean(axis=-1))


def seed_variance(images: Sequence[FloatArray], reference: FloatArray, least_seeds: int = 3) -> Error:
    """Expected relative squared error of one render about its own mean, from independent seeds."""
    return reduce_error(seed_variance_map(images, reference, least_seeds)[known_pixels(reference)])


def seed_deviations(images: Sequence[FloatArray], reference: FloatArray) -> list[Error]:
    """What each seed contributes to the seed variance: the figures in `whole` have that of `seed_variance` as mean.

    Squared distances from the mean of all seeds, times count / (count - 1). Of two images both are as far from their
    mean: their figures are equal and have no spread.
    """
    scale, count = image_scale(reference), len(images)
    stack = np.stack([_colour(image) for image in images]) / scale
    r = _colour(reference) / scale
    squared = (stack - stack.mean(axis=0)) ** 2 * (count / max(count - 1, 1))
    known = known_pixels(reference)
    return [reduce_error(seed.mean(axis=-1)[known]) for seed in squared / (r**2 + EPSILON)]


def percentage_error(image: FloatArray, reference: FloatArray) -> Error:
    """Mean of |x - r| / (r + 0.01) over pixels and RGB, both divided by the mean of r."""
    scale = image_scale(reference)
    x, r = _colour(image) / scale, _colour(reference) / scale
    return reduce_error((np.abs(x - r) / (np.abs(r) + EPSILON)).mean(axis=-1)[known_pixels(reference)])


def absolute_percentage_error(image: FloatArray, reference: FloatArray) -> float:
    """`percentage_error` of all pixels."""
    return percentage_error(image, reference).whole


def flip_map(image: FloatArray, reference: FloatArray) -> npt.NDArray[np.float64]:
    """HDR-FLIP of each pixel, float64 (height, width); its exposures follow from the reference alone, so they are fixed
    for a scene.

    References: Andersson et al. 2021, "Visualizing errors in rendered high dynamic range images".
    """
    from flip_evaluator import evaluate

    known = known_pixels(reference)[..., None]

    def prepare(pixels: FloatArray) -> npt.NDArray[np.float32]:
        # What is not known is black in both.
        shown = np.where(known, np.nan_to_num(_colour(pixels)), 0.0)
        return np.ascontiguousarray(np.maximum(shown, 0.0), np.float32)

    errors, _, _ = evaluate(prepare(reference), prepare(image), "HDR", inputsRGB=False, applyMagma=False)
    return np.asarray(errors, np.float64)[..., 0]


def flip(image: FloatArray, reference: FloatArray) -> float:
    """Mean of `flip_map` where the reference is known."""
    return float(flip_map(image, reference)[known_pixels(reference)].mean())


# ---------------------------------------------------------------------------------------------------------------------
# Same picture?


@dataclass(frozen=True)
class CellComparison:
    """Cell means of two renderers over a grid, relative to the second one's.

    difference : float64 (rows, columns), (mean_a - mean_b) / mean_b, of the mean over channels
    standard_error : float64 (rows, columns), of `difference`
    """

    difference: npt.NDArray[np.float64]
    standard_error: npt.NDArray[np.float64]

    def exceeds(self, allowance: float, sigmas: float) -> npt.NDArray[np.bool_]:
        """Cells whose difference is beyond both a relative allowance and a count of standard errors."""
        return np.asarray(np.abs(self.difference) > np.maximum(allowance, sigmas * self.standard_error))


def compare_cells(
    images_a: Sequence[FloatArray], images_b: Sequence[FloatArray], rows: int = 8, columns: int = 8
) -> CellComparison:
    """`compare_cell_means` of the pictures of two renderers' seeds."""
    return compare_cell_means(picture_means(images_a, rows, columns), picture_means(images_b, rows, columns))


def compare_cell_means(a: PictureMeans, b: PictureMeans) -> CellComparison:
    """Compare the cell means of two renderers, by the variances of pixels.

    In blue-noise order neighbours err in opposite directions, so that cells vary less than that.
    Relative to the second renderer's cell, or to `CELL_FLOOR` of its image mean if that is more: a black cell with one
    grey pixel of an edge has no relative difference worth the name.
    """
    floor = CELL_FLOOR * abs(float(b.channels[:3].mean())) or 1.0
    denominator = np.maximum(np.abs(b.cells), floor)
    variance = a.cell_variances + b.cell_variances
    return CellComparison((a.cells - b.cells) / denominator, np.sqrt(variance) / denominator)


def compare_means(
    images_a: Sequence[FloatArray], images_b: Sequence[FloatArray]
) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    """`compare_channel_means` of the pictures of two renderers' seeds."""
    return compare_channel_means(picture_means(images_a, 1, 1), picture_means(images_b, 1, 1))


def compare_channel_means(
    a: PictureMeans, b: PictureMeans
) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    """Relative difference of every channel's image mean, and its standard error; float64 (channels,) each.

    Relative to the second renderer's channel, floored at 1% of its mean over all channels.
    """
    denominator = np.maximum(np.abs(b.channels), max(0.01 * float(np.abs(b.channels).mean()), 1e-12))
    error = np.sqrt(a.channel_variances + b.channel_variances)
    return (a.channels - b.channels) / denominator, error / denominator
