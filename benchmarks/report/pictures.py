# SPDX-License-Identifier: GPL-3.0-or-later
"""Pictures on the page: renders, false-colour maps of their errors, and the crop where rivals differ most."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from benchmarks import metrics
from benchmarks.images import Float32Array, auto_exposure, tone_map
from benchmarks.rendering import image_stack
from benchmarks.report.collect import Batch, SceneResults

Map = npt.NDArray[np.float64]

#: Colours of error maps: dark to bright in even steps, told apart by the colour-blind too.
COLOUR_MAP = "inferno"
#: Side of the crop, as a share of the image's.
CROP_SHARE = 0.25
_LEAST_CROP = 16


@dataclass(frozen=True)
class Crop:
    """A rectangle of pixels; (x, y) is its upper left corner."""

    x: int
    y: int
    width: int
    height: int

    def cut(self, pixels: npt.NDArray[Any]) -> npt.NDArray[Any]:
        """That part of (height, width, ...)."""
        return pixels[self.y : self.y + self.height, self.x : self.x + self.width]


def error_map(batch: Batch, scene: SceneResults, truth: Float32Array) -> Map:
    """Relative squared error per pixel, mean over seeds: against the reference, or by the variance over seeds.

    One seed without a reference is compared with the mean of all renders. Where a reference is not known it is 0.
    """
    images = image_stack(batch.renders)
    if scene.reference is None and len(images) > 1:
        return metrics.seed_variance_map(images, truth, least_seeds=2)
    errors = np.mean([metrics.relative_squared_error_map(image, truth) for image in images], axis=0)
    return np.where(metrics.known_pixels(truth), errors, 0.0)


def _window_means(pixels: Map, width: int, height: int) -> Map:
    """Means over all windows of that size, by their upper left corners."""
    sums = np.pad(pixels, ((1, 0), (1, 0))).cumsum(axis=0).cumsum(axis=1)
    total = sums[height:, width:] - sums[:-height, width:] - sums[height:, :-width] + sums[:-height, :-width]
    return np.asarray(total / (width * height))


def choose_crop(maps: Sequence[Map]) -> Crop:
    """The window in which the rivals' errors differ most: the largest less the smallest of their roots' means.

    Roots and a limit at the 99.9th percentile keep single bright pixels from deciding.
    """
    rows, columns = maps[0].shape
    width = min(max(round(columns * CROP_SHARE), _LEAST_CROP), columns)
    height = min(max(round(rows * CROP_SHARE), _LEAST_CROP), rows)
    limit = float(np.percentile(np.stack(maps), 99.9))
    means = np.stack([_window_means(np.sqrt(np.clip(np.nan_to_num(one), 0.0, limit)), width, height) for one in maps])
    contrast = means.max(axis=0) - means.min(axis=0) if len(maps) > 1 else means[0]
    y, x = np.unravel_index(int(np.argmax(contrast)), contrast.shape)
    return Crop(int(x), int(y), width, height)


def colour_range(maps: Sequence[Map]) -> tuple[float, float]:
    """Least and largest error of the colour scale, powers of ten, the same for all rivals."""
    stacked = np.stack(maps)
    positive = stacked[np.isfinite(stacked) & (stacked > 0.0)]
    if not positive.size:
        return 1e-4, 1.0
    low, high = np.percentile(positive, (5.0, 99.0))
    least, most = 10.0 ** np.floor(np.log10(low)), 10.0 ** np.ceil(np.log10(high))
    return float(max(least, most * 1e-4)), float(max(most, least * 10.0))


def false_colour(errors: Map, limits: tuple[float, float]) -> npt.NDArray[np.uint8]:
    """Logarithm of errors through `COLOUR_MAP`; uint8 (height, width, 3). NaN shows as the largest."""
    import matplotlib

    low, high = np.log10(limits)
    finite = np.nan_to_num(errors, nan=limits[1], posinf=limits[1])
    position = (np.log10(np.maximum(finite, limits[0])) - low) / (high - low)
    colours = matplotlib.colormaps[COLOUR_MAP](np.clip(position, 0.0, 1.0))
    return np.asarray((colours[..., :3] * 255.0 + 0.5).astype(np.uint8))


def scale_colours(count: int = 9) -> list[str]:
    """Colours of the scale from least to largest, as CSS has them."""
    import matplotlib

    return [matplotlib.colors.to_hex(matplotlib.colormaps[COLOUR_MAP](t)) for t in np.linspace(0.0, 1.0, count)]


def save_png(path: Path, pixels: npt.NDArray[np.uint8]) -> None:
    """Write uint8 (height, width, 3)."""
    from PIL import Image

    path.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(np.ascontiguousarray(pixels)).save(path, optimize=True)


@dataclass(frozen=True)
class Picture:
    """Files of one render, relative to the page.

    label : rival and budget, or "reference"; rival, budget : '' for the reference
    """

    label: str
    rival: str
    budget: str
    image: str
    error: str = ""
    crop: str = ""
    crop_error: str = ""


@dataclass(frozen=True)
class ScenePictures:
    """All pictures of a scene, the crop, and the least and largest error of the colour scale."""

    pictures: list[Picture]
    crop: Crop
    limits: tuple[float, float]


def write_pictures(scene: SceneResults, truth: Float32Array, folder: Path, prefix: str) -> ScenePictures:
    """Write the PNG files of a scene into `folder`, their names beginning with `prefix`.

    Pictures are first seeds, all under one exposure; error maps are of all seeds. Crops are written for the largest
    budget.
    """
    final = scene.final()
    maps = {id(batch): error_map(batch, scene, truth) for batch in scene.batches}
    crop = choose_crop([maps[id(batch)] for batch in final])
    limits = colour_range([maps[id(batch)] for batch in final])
    exposure = auto_exposure(truth)
    pictures = []

    def save(name: str, pixels: npt.NDArray[np.uint8]) -> str:
        save_png(folder / f"{prefix}_{name}.png", pixels)
        return f"{prefix}_{name}.png"

    if scene.reference is not None:
        shown = tone_map(truth, exposure)
        pictures.append(
            Picture("reference", "", "", save("reference", shown), crop=save("reference_crop", crop.cut(shown)))
        )
    for rival in scene.rivals:
        for batch in scene.of_rival(rival):
            name = f"{file_name(rival)}_{batch.budget}"
            shown = tone_map(batch.renders[0].image, exposure)
            errors = false_colour(maps[id(batch)], limits)
            is_final = any(batch is one for one in final)
            pictures.append(
                Picture(
                    f"{rival}, {batch.budget}",
                    rival,
                    str(batch.budget),
                    save(name, shown),
                    save(f"{name}_error", errors),
                    save(f"{name}_crop", crop.cut(shown)) if is_final else "",
                    save(f"{name}_crop_error", crop.cut(errors)) if is_final else "",
                )
            )
    return ScenePictures(pictures, crop, limits)


def file_name(text: str) -> str:
    """Text as a part of a file's name."""
    return "".join(c if c.isalnum() or c in "-_." else "-" for c in text)
