# SPDX-License-Identifier: GPL-3.0-or-later
"""Adaptive sampling: pixels whose noise is below a threshold get no more samples.

As Cycles does it: the film keeps half of the samples apart, and how far that half's mean is from the mean of all tells
the noise of a pixel. All pixels are looked at together, after fixed numbers of samples, so that what is decided depends
on samples alone, never on threads or the clock. A pixel has as many neighbours sampled with it as touch it: what is
judged by few samples misses rare bright paths, and those are seldom one pixel's own matter.

Whether a pixel goes on depends on its samples. So the mean of a pixel that stops early is a little darker than the true
one on average: it stopped because it saw no bright path (docs/decisions/noise-threshold.md).

References
----------
Dammertz et al. 2010, "A Hierarchical Automatic Stopping Condition for Monte Carlo Global Illumination", section 2.1.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from engine.guiding.models.residual import cached_noise, residual_noise
from engine.render.film import Film
from engine.render.loop_state import LooksState
from engine.render.tiles import FrameTiles, Tile
from engine.settings import RenderSettings

#: Samples between two looks at the picture.
LOOK_INTERVAL = 16
#: A pixel has converged below so many times the threshold that a user gives.
_ERROR_PER_THRESHOLD = 5.0
#: Of a threshold that is left to the renderer.
_LEAST_AUTOMATIC_THRESHOLD = 0.001
#: Fewest samples of all, and what the fewest follow from where they are left to the renderer:
#: ceil(16 / threshold^0.3), which is 64 for a threshold of 0.01.
_LEAST_SAMPLES = 4
_SAMPLES_AT_ONE, _SAMPLES_POWER = 16.0, 0.3
#: Keeps black pixels from dividing by zero.
_EPSILON = 1e-4
#: Least pixels of a unit of work, so that it has paths enough for all lanes, and units that a picture is divided into
#: at least while there are more pixels than that.
_LEAST_UNIT_PIXELS, _LEAST_UNITS = 128, 64


class NoiseThreshold(NamedTuple):
    """When pixels have converged.

    threshold : float, of a user's scale
    least_samples : int, that every pixel gets
    """

    threshold: float
    least_samples: int

    @classmethod
    def of_settings(cls, settings: RenderSettings) -> NoiseThreshold:
        """The threshold of a render, with what the settings leave to the renderer (0)."""
        threshold = settings.adaptive_threshold or max(_LEAST_AUTOMATIC_THRESHOLD, 1.0 / settings.samples)
        least = settings.adaptive_min_samples or math.ceil(_SAMPLES_AT_ONE / threshold**_SAMPLES_POWER)
        return cls(threshold, max(least, _LEAST_SAMPLES))

    @property
    def largest_error(self) -> float:
        """What `pixel_errors` must be below."""
        return _ERROR_PER_THRESHOLD * self.threshold

    def next_look(self, samples: int) -> int:
        """Samples a pixel at the next look, a multiple of LOOK_INTERVAL, of a render that has come to `samples`.

        That is a multiple too where it was looked at, and may be none where guiding was given up.
        """
        first = self.least_samples + 2  # Cycles' count: at a sample whose index is above the least
        return math.ceil(max(first, samples + LOOK_INTERVAL // 2) / LOOK_INTERVAL) * LOOK_INTERVAL


def pixel_errors(film: Film, pixels: np.ndarray, exposure: float) -> np.ndarray:
    """How far pixels are from their half of the samples, over the root of their brightness, or that itself above one.

    Brightness is the sum over channels, after exposure. With a converging radiance cache it is the picture that is
    judged: what is known of the light that the cache lacks has two halves of its own, and what is lacking still counts
    as an error.

    Parameters
    ----------
    film : Film
        With a half.
    pixels : int64 (P,)
    exposure : float

    Returns
    -------
    float32 (P,)
        Infinite where there is nothing to compare.
    """
    sums = film.sums
    weight, half_weight = sums.weight[pixels], sums.half_weight[pixels]
    is_known = (half_weight > 0.0) & (half_weight < weight)
    mean = sums.radiance[pixels] / np.where(is_known, weight, np.float32(1.0))[:, None]
    difference = mean - sums.half[pixels] / np.where(is_known, half_weight, np.float32(1.0))[:, None]
    lacking = np.zeros(len(pixels), np.float32)
    if len(sums.residual):
        total = np.maximum(sums.weight, np.float32(1e-20))
        found = residual_noise(
            sums.residual / total[:, None], sums.residual_square / total**2, (film.height, film.width),
            cached_noise(sums, (film.height, film.width)),
        )
        mean = np.maximum(mean + found.known[pixels], np.float32(0.0))
        difference = difference + found.difference[pixels]
        lacking = found.lacking[pixels]
    scale = np.float32(exposure)
    distance = scale * (np.abs(difference).sum(axis=1) + np.float32(mean.shape[1]) * lacking)
    brightness = scale * mean.sum(axis=1)
    norm = np.where(brightness < 1.0, np.sqrt(np.maximum(brightness, np.float32(0.0))), brightness)
    return np.where(is_known, distance / (np.float32(_EPSILON) + norm), np.float32(np.inf))


def _grown(mask: np.ndarray) -> np.ndarray:
    """Pixels that are set or touch one that is, of 3 x 3: bool (height, width)."""
    padded = np.pad(mask, 1)
    rows = padded[:-2] | padded[1:-1] | padded[2:]
    return rows[:, :-2] | rows[:, 1:-1] | rows[:, 2:]


class ActivePixels:
    """Which pixels of a render go on.

    Parameters
    ----------
    settings : RenderSettings
        With adaptive sampling.
    film : Film
        With a half.
    exposure : float
    tiles : FrameTiles
        All pixels.

    Attributes
    ----------
    rule : NoiseThreshold
    tiles : sequence of Tile, of the pixels that go on
    count : int, of these
    expected_paths : float
        That they are still to get, as far as their errors tell: noise falls with the square root of samples.
    has_looked : bool
    """

    def __init__(self, settings: RenderSettings, film: Film, exposure: float, tiles: FrameTiles) -> None:
        self.rule = NoiseThreshold.of_settings(settings)
        self.tiles: Sequence[Tile] = tiles
        self.count = tiles.pixel_count
        self.expected_paths = float(self.count) * settings.samples
        self.has_looked = False
        self._all_tiles = tiles
        self._most_pixels = tiles.largest
        self._samples = settings.samples
        self._film, self._exposure = film, exposure
        self._is_active = np.ones(film.width * film.height, np.bool_)
        self._looked_at = 0

    @property
    def state(self) -> LooksState:
        """What was found so far."""
        if not self.has_looked:
            return LooksState()
        return LooksState(self._is_active.copy(), self._looked_at, self.expected_paths)

    def resume(self, state: LooksState) -> None:
        """Go on from what was found before the render was interrupted."""
        if len(state.is_active):
            self._is_active, self._looked_at, self.has_looked = state.is_active, state.pixels_looked_at, True
            self.count, self.expected_paths = int(np.count_nonzero(self._is_active)), state.expected_paths
            self.tiles = self._divide()

    @property
    def share(self) -> float | None:
        """Of the pixels, that go on; None: nobody has looked."""
        return self.count / len(self._is_active) if self.has_looked else None

    def is_due(self, samples: int) -> bool:
        """Whether to look at the picture after so many samples a pixel, of which iterations are no multiple of 16."""
        is_enough = samples > self.rule.least_samples + 1
        return is_enough and (not self.has_looked or samples - self._looked_at >= LOOK_INTERVAL)

    def look(self, samples: int) -> None:
        """Drop the pixels that have converged.

        Parameters
        ----------
        samples : int
            Samples of a pixel that has been active all along.
        """
        self._looked_at, self.has_looked = samples, True
        film, active = self._film, np.flatnonzero(self._is_active)
        errors = pixel_errors(film, active, self._exposure)
        is_noisy = np.zeros(len(self._is_active), np.bool_)
        # Written so that NaN goes on.
        is_noisy[active] = ~(errors < self.rule.largest_error)
        self._is_active = _grown(is_noisy.reshape(film.height, film.width)).ravel()
        self.count = int(np.count_nonzero(self._is_active))
        left = max(self._samples - samples, 0)
        wanted = film.sums.count[active] * np.maximum((errors / self.rule.largest_error) ** 2 - 1.0, 0.0)
        # A pixel gets at least what is between two looks, for its neighbours' sake too.
        expected = np.clip(np.nan_to_num(wanted, nan=np.inf), LOOK_INTERVAL, left)
        self.expected_paths = float(expected[self._is_active[active]].sum()) if left else 0.0
        self.tiles = self._divide()

    def _divide(self) -> list[Tile]:
        """The pixels that go on, tile by tile, in units of the same size."""
        most = min(max(self.count // _LEAST_UNITS, _LEAST_UNIT_PIXELS), self._most_pixels)
        unit_count = math.ceil(self.count / most)
        if not unit_count:
            return []
        pixels, index = (np.concatenate(column) for column in zip(*self._all_tiles, strict=True))
        kept = np.flatnonzero(self._is_active[index])
        return [(pixels[unit], index[unit]) for unit in np.array_split(kept, unit_count)]
