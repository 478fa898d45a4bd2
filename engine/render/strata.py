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

import numpy as np

from engine.methods import SOURCES
from engine.render.film import Film
from engine.settings import RenderSettings
from engine.state.film import FIRST_DEPTH, PLAIN_LAYOUT, FilmLayout, FilmTile
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


def strata_count(settings: RenderSettings, film_bytes: int) -> int:
    """How many strata a render has, 1 = none: a power of two.

    Parameters
    ----------
    settings : RenderSettings
    film_bytes : int
        Of a film without strata.
    """
    if not settings.is_guided or not SOURCES[settings.source].is_mixture:
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
        first = self.sums.count[pixels] == 0
        if self.layout.use_features:
            self.sums.points[pixels[first]] = tile.points[: len(pixels)][first]
        self._combine(pixels)
        return tile

    def _by_pixel(self, tile: FilmTile, pixel_count: int) -> FilmTile:
        """Sums over the strata of a unit of them all; of points, those of the stratum that has some."""
        strata = len(self._first)
        columns = {
            name: column[: pixel_count * strata].reshape(pixel_count, strata, *column.shape[1:]).sum(axis=1)
            for name, column in tile._asdict().items()
            if len(column) and name not in ("points", "mattes")
        }
        if len(tile.points):
            depths = tile.points[: pixel_count * strata, FIRST_DEPTH].reshape(pixel_count, strata)
            first = np.argmax(depths != 0.0, axis=1)
            columns["points"] = tile.points[np.arange(pixel_count) * strata + first]
        return tile._replace(**{name: np.ascontiguousarray(column) for name, column in columns.items()})

    def _combine(self, pixels: np.ndarray) -> None:
        """Sums of pixels from those of their strata: each stratum that has samples counts the same."""
        rows = self._first[:, None] + pixels
        sums, whole = self.by_stratum.sums, self.sums
        weight = sums.weight[rows]
        total = weight.sum(axis=0)
        is_present = weight > 0.0
        factor = np.where(is_present, total / np.maximum(is_present.sum(axis=0), 1), np.float32(0.0))
        factor /= np.where(is_present, weight, np.float32(1.0))
        whole.weight[pixels] = total
        whole.count[pixels] = sums.count[rows].sum(axis=0)
        whole.alpha[pixels] = (sums.alpha[rows] * factor).sum(axis=0)
        whole.weight_squared[pixels] = (sums.weight_squared[rows] * factor * factor).sum(axis=0)
        whole.radiance[pixels] = (sums.radiance[rows] * factor[..., None]).sum(axis=0)
        whole.square[pixels] = (sums.square[rows] * factor[..., None]).sum(axis=0)
        if len(whole.residual):
            whole.residual[pixels] = (sums.residual[rows] * factor[..., None]).sum(axis=0)
            whole.residual_square[pixels] = (sums.residual_square[rows] * factor**2).sum(axis=0)
            whole.square_gain[pixels] = (sums.square_gain[rows] * factor).sum(axis=0)
            whole.ended[pixels] = (sums.ended[rows] * factor).sum(axis=0)
        if len(whole.half):
            whole.half[pixels], whole.half_weight[pixels] = self._halves(rows)
        if len(whole.denoising):
            whole.denoising[pixels] = (sums.denoising[rows] * factor[..., None]).sum(axis=0)
        if len(whole.caught):
            whole.caught[pixels] = (sums.caught[rows] * factor[..., None]).sum(axis=0)
        if len(whole.light):
            whole.light[pixels] = (sums.light[rows] * factor[..., None]).sum(axis=0)
        if self.layout.use_features:
            whole.features[pixels] = (sums.features[rows] * factor[..., None]).sum(axis=0)
        if len(whole.data):
            whole.data[pixels] = (sums.data[rows] * factor[..., None]).sum(axis=0)
        if len(whole.mattes):
            whole.mattes[pixels] = 0.0
            for of_stratum, factors in zip(rows, factor, strict=True):
                self._merge_mattes(pixels, sums.mattes, of_stratum, factors)

    def _halves(self, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """As `radiance` and `weight` are made, of the half of the samples."""
        sums = self.by_stratum.sums
        weight = sums.half_weight[rows]
        total, is_present = weight.sum(axis=0), weight > 0.0
        factor = np.where(is_present, total / np.maximum(is_present.sum(axis=0), 1), np.float32(0.0))
        factor /= np.where(is_present, weight, np.float32(1.0))
        return (sums.half[rows] * factor[..., None]).sum(axis=0), total

    @property
    def nbytes(self) -> int:
        """Memory of the sums."""
        return super().nbytes + self.by_stratum.nbytes


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
