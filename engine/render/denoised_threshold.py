# SPDX-License-Identifier: GPL-3.0-or-later
"""A threshold on the denoised picture: the render ends once that errs by less, as estimated.

The film keeps half of the samples apart (`engine.wavefront.accumulate.is_in_half`). Both halves are denoised as the
picture will be, by albedo and normal of all samples. How far they are from each other tells the noise that denoising
leaves. What both get wrong alike they do not tell: it is accounted for by a factor that was measured
(docs/decisions/denoising.md).

To denoise all of a large picture costs as much as several samples a pixel. So cells of it are denoised, chosen in
proportion to the noise that they have before: the share of noise that is left in these stands for that in all.

The picture is looked at after numbers of samples that grow geometrically, so that what is decided depends on samples
alone, never on threads or the clock.
"""

from __future__ import annotations

import math
import threading
from dataclasses import replace

import numpy as np

from engine.render.denoising import Denoising, failure, variance_is_all
from engine.render.film import Film
from engine.render.loop_state import LooksState
from engine.scene.description import Notice
from engine.settings import RenderSettings

#: Samples a pixel at the first look, and how many times as many at each that follows.
_FIRST_LOOK = 16
_LOOK_GROWTH = 1.5
#: Error of the denoised picture over the noise of one denoised half, after so many samples a pixel: what is left of the
#: noise where all samples are denoised, and over the root of the samples what both halves get wrong alike, as measured.
_NOISE_OF_WHOLE, _UNSEEN = 0.7, 3.2
#: Of the sRGB curve: where its straight part ends, and its slope at white.
_STRAIGHT, _SLOPE_AT_WHITE = np.float32(0.0031308), np.float32(1.055 / 2.4)
#: Pixels that a cell is wide and high, about; cells that are denoised at least, and one of how many.
_CELL_SIZE = 128
_LEAST_CELLS, _CELLS_PER_LOOK = 4, 8
#: Where among the cells of a look the choice begins, look by look: never near where it began before.
_GOLDEN = 0.5 * (math.sqrt(5.0) - 1.0)
#: Bright enough: what is above has no number to be counted with.
_BRIGHTEST = np.float32(1e18)


def display_values(radiance: np.ndarray) -> np.ndarray:
    """What a screen shows, 0 for black and 1 for white: the sRGB curve.

    Above white it goes on as the logarithm, by the slope that the curve has there. A view transform shows highlights
    as well, and a firefly must not decide by itself.

    Parameters
    ----------
    radiance : float32, scene-linear, after exposure

    Returns
    -------
    float32
    """
    value = np.nan_to_num(np.clip(radiance, np.float32(0.0), _BRIGHTEST))
    curve = np.float32(1.055) * np.minimum(value, np.float32(1.0)) ** np.float32(1.0 / 2.4) - np.float32(0.055)
    curve = np.where(value <= _STRAIGHT, np.float32(12.92) * value, curve)
    shown: np.ndarray = curve + _SLOPE_AT_WHITE * np.log(np.maximum(value, np.float32(1.0)))
    return shown.astype(np.float32)


def half_pictures(film: Film, picture: np.ndarray, exposure: float) -> tuple[np.ndarray, np.ndarray]:
    """The two pictures of the film's halves of the samples, float32 (height, width, 3) each.

    Parameters
    ----------
    film : Film
        With a half.
    picture : float32 (height, width, >= 3)
        Of all samples. Where it has what radiance alone has not (shadows that are caught), both halves have it too. A
        pixel of which one half is empty has it in both.
    exposure : float
        Of `picture`.
    """
    sums, factor = film.sums, np.float32(exposure)
    rest = sums.weight - sums.half_weight
    is_known = (sums.half_weight > 0.0) & (rest > 0.0)
    total = sums.radiance / np.where(is_known, sums.weight, np.float32(1.0))[:, None]
    first = sums.half / np.where(is_known, sums.half_weight, np.float32(1.0))[:, None]
    second = (sums.radiance - sums.half) / np.where(is_known, rest, np.float32(1.0))[:, None]
    seen = picture[..., :3].reshape(-1, 3)
    first, second = (
        np.where(is_known[:, None], seen + factor * (half - total), seen).astype(np.float32) for half in (first, second)
    )
    shape = (film.height, film.width, 3)
    return first.reshape(shape), second.reshape(shape)


def _squared_difference(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Of display values by pixel, mean over channels: float32 (height, width)."""
    return np.square(display_values(first) - display_values(second)).mean(axis=2)


#: Rows and columns of a picture.
Cell = tuple[slice, slice]


def _edges(size: int) -> list[slice]:
    """Parts of a row or column of cells, of about the same size."""
    count = max(round(size / _CELL_SIZE), 1)
    return [slice(size * index // count, size * (index + 1) // count) for index in range(count)]


def chosen_cells(noise: np.ndarray, look: int) -> list[tuple[Cell, float]]:
    """Cells of a picture, each with the factor by which what is left of its noise counts for the whole picture's mean.

    Cells are chosen systematically, with probabilities proportional to their noise, so that the weighted sum is on
    average the mean over the picture. A picture of few cells is one.

    Parameters
    ----------
    noise : float (height, width), not negative
        By pixel.
    look : int
        Each has a choice of its own.
    """
    height, width = noise.shape
    cells = [(rows, columns) for rows in _edges(height) for columns in _edges(width)]
    total = float(noise.sum(dtype=np.float64))
    if len(cells) <= _LEAST_CELLS or total <= 0.0:
        return [((slice(0, height), slice(0, width)), 1.0 / max(noise.size, 1))]
    count = max(-(-len(cells) // _CELLS_PER_LOOK), _LEAST_CELLS)
    of_cell = np.array([noise[cell].sum(dtype=np.float64) for cell in cells])
    places = (np.arange(count) + (0.5 + look * _GOLDEN) % 1.0) * (total / count)
    index = np.minimum(np.searchsorted(np.cumsum(of_cell), places, side="right"), np.flatnonzero(of_cell)[-1])
    times = np.bincount(index, minlength=len(cells))
    return [
        (cells[one], float(times[one] / count * total / of_cell[one] / noise.size)) for one in np.flatnonzero(times)
    ]


class DenoisedThreshold:
    """When the denoised picture of a render is good enough.

    Parameters
    ----------
    settings : RenderSettings
        With a threshold and denoising.
    film : Film
        With a half.
    exposure : float
    thread_count : int
        Those that trace, which wait meanwhile.

    Attributes
    ----------
    due : float
        Samples a pixel from which on it is time to look.
    error : float or None
        As `estimate` found it at the last look; None: there was none.
    looked_at : int
        Samples a pixel at that.
    notices : list of Notice
        Why it looks no more.
    """

    def __init__(self, settings: RenderSettings, film: Film, exposure: float, thread_count: int) -> None:
        self._threshold, self._film, self._exposure = settings.denoised_threshold, film, exposure
        self._denoising = Denoising(settings, thread_count)
        self._is_stopped = threading.Event()
        self._looks = 0
        self.due: float = _FIRST_LOOK
        self.error: float | None = None
        self.looked_at = 0
        self.notices: list[Notice] = []

    def state(self, found: LooksState) -> LooksState:
        """What pixels' looks have found, with what was found here."""
        due, error = -1 if math.isinf(self.due) else int(self.due), -1.0 if self.error is None else self.error
        return replace(found, due=due, looks=self._looks, looked_at=self.looked_at, error=error)

    def resume(self, state: LooksState) -> None:
        """Go on from what was found before the render was interrupted."""
        if state.looks:
            self.due = state.due if state.due >= 0 else math.inf
            self._looks, self.looked_at = state.looks, state.looked_at
            self.error = state.error if state.error >= 0.0 else None

    def is_due(self, samples: int) -> bool:
        """Whether to look at the picture after so many samples a pixel."""
        return samples >= self.due and not self._is_stopped.is_set()

    def stop(self) -> None:
        """End a look that is under way, and look no more."""
        self._is_stopped.set()

    def look(self, samples: int) -> bool:
        """Denoise halves of the picture; whether it is good enough."""
        self.due = math.ceil(_LOOK_GROWTH * samples)
        self._looks += 1
        try:
            error = self.estimate(samples)
        except Exception as problem:  # whatever went wrong: the render goes on
            self.notices.append(Notice("Denoised Noise", failure(problem), "it ends no render"))
            self.due = math.inf
            return False
        if error is None:
            return False
        self.error, self.looked_at = error, samples
        return error < self._threshold

    def estimate(self, samples: int) -> float | None:
        """Root mean square error of the denoised picture's display values, estimated; None: it was stopped."""
        film, exposure = self._film, self._exposure
        images = film.images({"Combined"} | self._denoising.passes, exposure=exposure)
        cached = film.has_residual
        picture = film.cached_image(exposure=exposure) if cached else images["Combined"]
        halves = half_pictures(film, picture, exposure)
        squared = 0.0
        for cell, factor in chosen_cells(_squared_difference(*halves), self._looks):
            denoised = self._denoising.filtered(
                [half[cell] for half in halves], {name: image[cell] for name, image in images.items()},
                self._is_stopped.is_set, mixes=variance_is_all(film),
            )
            if denoised is None:
                return None
            first, second = denoised
            if cached:
                first, second = film.halves_with_residual((first, second), cell, exposure=exposure)
            squared += factor * float(_squared_difference(first, second).sum(dtype=np.float64))
        # Each half has half of the squared difference.
        return (_NOISE_OF_WHOLE + _UNSEEN / math.sqrt(samples)) * math.sqrt(0.5 * squared)
