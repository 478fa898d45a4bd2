# SPDX-License-Identifier: GPL-3.0-or-later
"""Strata of u: a render that goes through the shutter, or the wavelengths, part by part, so that what it learns has
one part to know.

After a pass over all strata, iterations belong to one stratum after the other, and what guides them is trained further
by what is found there. The image is the mean of the strata's means at every moment, so it is whole however the render
ends: a stratum not yet come to has its samples from the first pass.

Strata are equal parts of the uniform number that a path's time is made from, hence of the light that the shutter lets
in, and a power of two: of the sampler's first 2^k points one lies in each of 2^k parts. While some have no sample, the
mean of the others is unbiased for that reason: which ones those are is a matter of chance alone. In wavelength they are
parts of the offset that a path's four wavelengths have in common: each stratum has a piece of every quarter of [0, 1).

References
----------
Dong et al. 2024, "Efficient Neural Path Guiding with 4D Modeling", section 4.2.
"""

from __future__ import annotations

from collections.abc import Callable
from enum import Enum

import numpy as np

from engine.methods import SOURCES
from engine.render.film import Film
from engine.settings import RenderSettings
from engine.state.columns import columns_of
from engine.state.film import PLAIN_LAYOUT, FilmLayout, FilmTile, Merge
from engine.state.unit import ALL_STRATA

#: Samples a pixel of a stratum, on average, and memory of all strata's sums [bytes]: with less, there are fewer strata.
_LEAST_SAMPLES = 8
_MOST_BYTES = 1 << 30
#: Length of the first pass: samples a pixel (but at least one for each stratum), and the share of time or samples that
#: ends it sooner.
_FIRST_PASS_SAMPLES = 32
_FIRST_PASS_SHARE = 0.125
#: Samples a pixel of a stratum's iterations: the first one is guided by what was learned in the last stratum.
_FIRST_LENGTH = 2
_LONGEST_LENGTH = 16

#: A film's sums of those of its strata (strata, P, ...) and their factors, by how the column is merged.
_COMBINED: dict[Enum | None, Callable[[np.ndarray, np.ndarray], np.ndarray]] = {
    Merge.SUM: lambda sums, factor: (sums * factor).sum(axis=0),
    Merge.SQUARED_SUM: lambda sums, factor: (sums * factor**2).sum(axis=0),
    Merge.TOTAL: lambda sums, factor: sums.sum(axis=0),
    Merge.COUNT: lambda sums, factor: sums.sum(axis=0),
    Merge.WEIGHT: lambda sums, factor: sums.sum(axis=0),
    Merge.SQUARED_WEIGHT: lambda sums, factor: (sums * factor * factor).sum(axis=0),
}


def are_learned(settings: RenderSettings) -> bool:
    """Whether what guides a render may learn one stratum after the other."""
    return settings.is_guided and SOURCES[settings.source].is_mixture


def strata_count(settings: RenderSettings, film_bytes: int) -> int:
    """How many strata a render has, 1 = none: a power of two.

    Parameters
    ----------
    settings : RenderSettings
    film_bytes : int
        Size of a film without strata.
    """
    if not are_learned(settings):
        return 1
    most = min(settings.strata, settings.samples // _LEAST_SAMPLES, _MOST_BYTES // max(film_bytes, 1))
    return 1 << max(most.bit_length() - 1, 0)


class StrataFilm(Film):
    """A film whose sums are such that their mean is the mean of the strata's means.

    Variances are those of samples of the whole shutter: what strata save is not in them.

    Parameters
    ----------
    width, height : int
    strata : int

    Attributes
    ----------
    by_stratum : Film
        The same of each stratum alone, one image above the other.
    """

    def __init__(self, width: int, height: int, strata: int, layout: FilmLayout = PLAIN_LAYOUT) -> None:
        super().__init__(width, height, layout)
        self.by_stratum = Film(width, height * strata, layout)
        #: Index of each stratum's first pixel in it.
        self._first = np.arange(strata) * (width * height)

    def merge_stratum(self, pixels: np.ndarray, tile: FilmTile, weight: float, stratum: int) -> FilmTile:
        """As `merge`, for a unit of a stratum or of ALL_STRATA, whose tile has a row a pixel for each stratum.

        Returns
        -------
        FilmTile
            Sums of the unit by pixel.
        """
        if stratum == ALL_STRATA:
            self.by_stratum.merge((pixels[:, None] + self._first).ravel(), tile, weight)
            tile = self._by_pixel(tile, len(pixels))
        else:
            self.by_stratum.merge(pixels + self._first[stratum], tile, weight)
        self._keep_first(pixels, tile)
        self.combine(pixels)
        return tile

    def _by_pixel(self, tile: FilmTile, pixel_count: int) -> FilmTile:
        """Sums over the strata of a unit of them all; of what is of the first sample, that of the first stratum that
        has some. Mattes stay as they are.
        """
        strata = len(self._first)
        columns = {}
        for name, declared in columns_of(type(tile)).items():
            values = getattr(tile, name)
            if not len(values) or declared.merge == Merge.MATTES:
                continue
            values = values[: pixel_count * strata].reshape(pixel_count, strata, *values.shape[1:])
            if declared.merge == Merge.FIRST:
                is_there = (values != 0).reshape(pixel_count, strata, -1).any(axis=2)
                values = values[np.arange(pixel_count), np.argmax(is_there, axis=1)]
            else:
                values = values.sum(axis=1)
            columns[name] = np.ascontiguousarray(values)
        return tile._replace(**columns)

    def combine(self, pixels: np.ndarray) -> None:
        """Sums of pixels from those of their strata: each stratum that has samples counts the same."""
        rows = self._first[:, None] + pixels
        factors: dict[str, np.ndarray] = {}
        for name, declared in columns_of(type(self.sums)).items():
            whole, parts = getattr(self.sums, name), getattr(self.by_stratum.sums, name)
            if not len(whole) or declared.merge == Merge.FIRST:
                continue
            weight = declared.weight or "weight"
            if weight not in factors:
                factors[weight] = _factor_of_strata(getattr(self.by_stratum.sums, weight)[rows])
            factor = factors[weight]
            if declared.merge == Merge.MATTES:
                whole[pixels] = 0.0
                for of_stratum, of_pixel in zip(rows, factor, strict=True):
                    self._merge_mattes(name, pixels, parts, of_stratum, of_pixel)
            else:
                of_row = factor.reshape(*factor.shape, *[1] * (parts.ndim - 1))
                whole[pixels] = _COMBINED[declared.merge](parts[rows], of_row)

    @property
    def nbytes(self) -> int:
        """Memory of the sums."""
        return super().nbytes + self.by_stratum.nbytes


def _factor_of_strata(weight: np.ndarray) -> np.ndarray:
    """What makes the mean of the strata's means of sums by strata: float32 (strata, P), 0 where one has no sample.

    Parameters
    ----------
    weight : float32 (strata, P)
        Weight of the samples of each stratum.
    """
    total, is_present = weight.sum(axis=0), weight > 0.0
    factor: np.ndarray = np.where(is_present, total / np.maximum(is_present.sum(axis=0), 1), np.float32(0.0))
    factor /= np.where(is_present, weight, np.float32(1.0))
    return factor


class StrataSchedule:
    """Which stratum an iteration belongs to, and how long it is: by samples and clock, never by what was sampled.

    Parameters
    ----------
    settings : RenderSettings
    strata : int
        2 or more.
    """

    def __init__(self, settings: RenderSettings, strata: int) -> None:
        self._samples = settings.samples
        self._seconds = settings.time_limit
        self._strata = strata
        self._stratum = ALL_STRATA
        self._length = 1
        self._last = 0, 0.0
        #: Sample and time at which the stratum is to be left.
        self._end_sample = max(min(_FIRST_PASS_SAMPLES, round(_FIRST_PASS_SHARE * self._samples)), strata)
        self._end_seconds = _FIRST_PASS_SHARE * self._seconds

    def next(self, sample: int, seconds: float) -> tuple[int, int] | None:
        """Stratum and samples a pixel of the iteration that begins with `sample`; None: that was all.

        Parameters
        ----------
        seconds : float
            Time since the beginning.
        """
        if sample >= self._samples:
            return None
        since_sample, since_seconds = self._last
        self._last = sample, seconds
        per_sample = (seconds - since_seconds) / max(sample - since_sample, 1)
        if self._is_over(sample, seconds, per_sample):
            self._go_on(sample, seconds)
        length = min(self._length, max(self._end_sample - sample, 1))
        if self._seconds and self._stratum != ALL_STRATA and per_sample > 0.0:
            length = max(min(length, round((self._end_seconds - seconds) / per_sample)), 1)
        self._length = min(2 * self._length, _LONGEST_LENGTH)
        return self._stratum, length

    def _is_over(self, sample: int, seconds: float, per_sample: float) -> bool:
        """Whether to leave the stratum."""
        if self._stratum == self._strata - 1:
            return False
        if self._stratum == ALL_STRATA and sample < self._strata:
            # All have a sample first.
            return False
        is_late = self._seconds > 0.0 and seconds + 0.5 * per_sample >= self._end_seconds
        return sample >= self._end_sample or is_late

    def _go_on(self, sample: int, seconds: float) -> None:
        """To the next stratum that there are samples for: the strata left share what is left of samples and time."""
        self._end_sample = sample
        while self._end_sample == sample:
            self._stratum += 1
            left = self._strata - self._stratum
            self._end_sample = sample + (self._samples - sample) // left
        self._end_seconds = seconds + max(self._seconds - seconds, 0.0) / left
        self._length = _FIRST_LENGTH
