# SPDX-License-Identifier: GPL-3.0-or-later
"""What the radiance cache learns between iterations, and how many paths measure what it lacks.

`CacheLearner` alone is the learner of a render that guides nothing; in a guided one it is a part of `Learner`.
"""

from __future__ import annotations

import math
import time
from collections.abc import Sequence

import numpy as np

from engine.guiding.fields.cells.model import CellModel
from engine.guiding.models.report import GuidingReport
from engine.guiding.models.residual import residual_error
from engine.guiding.policy.costs import IterationCosts
from engine.guiding.policy.guidance import Guidance
from engine.guiding.policy.iterations import RecordBudget, iteration_weight
from engine.guiding.policy.rules import RULES, Rules
from engine.guiding.policy.trial import Part
from engine.guiding.records.of_unit import UnitRecords
from engine.guiding.records.taught import allocate_taught_records, join_taught
from engine.ris.orca import image_variance, pixel_weights, sample_variance
from engine.scene.description import Notice
from engine.settings import RenderSettings
from engine.state.film import FilmTile
from engine.state.unit import CURRENT, Unit, UnitCosts

_REHEARSED_RECORDS = 16


def _variance_gain(
    mean: np.ndarray, square_gain: np.ndarray, known: np.ndarray, weights: np.ndarray, cut_percent: float
) -> float:
    """By how much the variance of the pixels would be larger without the cache, weighted mean.

    Parameters
    ----------
    mean, known : float32 (P, C), of the cached image, and what is known of what it lacks
    square_gain : float32 (P,)
        See `FilmTile.square_gain`, of one sample.
    weights : float32 (P,)
        See `pixel_weights`, by what the variance of a pixel's mean is of that of one sample.
    cut_percent : float
        Of the pixels: so many of the largest and of the smallest are cut to the next.
    """
    gain = (square_gain - (known * (known + 2.0 * mean)).mean(axis=1)) * weights
    low, high = np.percentile(gain, (cut_percent, 100.0 - cut_percent))
    return float(np.clip(gain, low, high).mean())


class CacheLearner:
    """Owns the cells of one render.

    Parameters
    ----------
    settings : RenderSettings
        With a radiance cache.
    paths_per_sample : int
        Pixels of the image.
    unit_pixels : int
        Of the largest unit of work.
    report : GuidingReport, optional
        Of the learner that this is a part of.
    rules : Rules
    """

    #: Nothing outlives the render.
    wants_last = False
    known_samples = 0.0

    def __init__(
        self, settings: RenderSettings, paths_per_sample: int, unit_pixels: int, report: GuidingReport | None = None,
        rules: Rules = RULES,
    ) -> None:
        self._rules = rules
        self.settings = settings
        self.notices: list[Notice] = []
        self.report = GuidingReport(method="OFF") if report is None else report
        self.parts = [Part(0, 1, CURRENT)]
        self._cells = CellModel()
        self._budget = RecordBudget(paths_per_sample, unit_pixels, rules=rules)
        #: Of the paths, to measure what the cache lacks; and the sample from which on it is judged again.
        self._share = rules.cache_measured_share if settings.radiance_cache == "CONVERGING" else 0.0
        self._judge_from = 0.0
        self._was_bad = False
        self.is_given_up = False

    @property
    def is_over(self) -> bool:
        """Whether there is nothing to learn any more, so that the render need not go in iterations."""
        return self.is_given_up

    def weight(self, first_sample: int, _arm: int) -> float:
        """Weight in the image of each sample of an iteration."""
        return iteration_weight(first_sample, self.settings, rules=self._rules)

    def narrow(self, pixel_count: int, _expected_paths: float) -> None:
        """Take how many pixels the next iteration has."""
        self._budget.paths_per_sample = pixel_count

    def rehearse(self) -> Guidance:
        """Load (or compile) the kernels of learning by learning from nothing in particular."""
        CellModel().learn(allocate_taught_records(_REHEARSED_RECORDS))
        return Guidance(self.settings, 0)

    def first(self) -> Guidance:
        """Guidance of the first iteration: none, but record."""
        return self.complete(Guidance(self.settings, self._budget.threshold(1)))

    def take(self, units: Sequence[UnitRecords]) -> int:
        """Learn from an iteration's records; returns how many there were."""
        started = time.perf_counter()
        records = join_taught([unit.taught for unit in units])
        self._cells.learn(records)
        self.report.field_seconds += time.perf_counter() - started
        return len(records.program)

    def complete(self, guidance: Guidance) -> Guidance:
        """Guidance whose paths end in what is known."""
        if self.is_given_up:
            return guidance
        return guidance.with_cells(self._cells.field, max(guidance.record_threshold, int(self._share * 2**32)))

    def judge(self, sums: FilmTile, size: tuple[int, int], next_sample: int) -> None:
        """Give the cache up where the image makes more error with it than without, as far as measuring paths tell.

        More of them measure where the noise of what they found, and what they have not found yet, is more than the
        noise of the cached image; else fewer.

        Parameters
        ----------
        sums : FilmTile, the image so far
        size : (int, int)
            Rows and columns of the image.
        next_sample : int
        """
        if self.is_given_up or not len(sums.residual) or next_sample < self._judge_from:
            return
        rules = self._rules
        self._judge_from = rules.cache_again * next_sample
        weight = np.maximum(sums.weight, 1e-20)[:, None]
        mean = sums.radiance / weight
        weights = pixel_weights(mean.reshape(*size, -1))
        # Of variances of single samples: a noise threshold gives pixels different numbers of them.
        of_samples = weights * (sums.weight_squared / weight[:, 0] ** 2)
        cached = image_variance(sample_variance(mean, sums.square / weight), of_samples)
        error = residual_error(sums.residual / weight, sums.residual_square / weight[:, 0] ** 2, size, weights)
        # What is surely wrong in the large is wrong in details too, of which the estimate sees a part only. And the
        # cached image has less noise than its samples tell where they are well spread.
        seen = error.wide_squared if error.wide_squared > rules.cache_sure * error.wide_noise else 0.0
        is_too_few = error.noise + max(error.bias_squared, rules.cache_ahead * seen) > cached
        self._share = min(max(self._share * (2.0 if is_too_few else 0.5), rules.cache_measured_share), 1.0)
        self.report.cache_bias = math.sqrt(error.bias_squared)
        if next_sample < rules.cache_early_samples:
            return
        gain = _variance_gain(
            mean, sums.square_gain / weight[:, 0], error.known, of_samples, rules.cache_cut_percent
        )
        whole = cached + gain
        lacking = max(error.bias_squared - rules.cache_doubt * error.bias_noise, 0.0)
        ratio = (cached + error.noise + lacking) / max(whole, 1e-20)
        said = float(((sums.ended / weight[:, 0]) ** 2 * weights).mean())
        is_wrong = seen > max(rules.cache_wrong * said, whole)
        self.is_given_up = is_wrong or ratio > rules.cache_too_bad or (ratio > rules.cache_bad and self._was_bad)
        self._was_bad = ratio > rules.cache_bad
        if self.is_given_up:
            self.report.cache_stopped_at = next_sample

    def learn(
        self, units: Sequence[UnitRecords], recorded_share: float, sums: FilmTile, size: tuple[int, int],
        costs: IterationCosts, next_range: tuple[int, int], *, is_whole: bool = True,
    ) -> Guidance:
        """Learn from an iteration, and say how to go on; see `Learner.learn`."""
        row_count = self.take(units)
        self.report.record_count += row_count
        if row_count:
            self._budget.count(row_count + costs.dropped_records, recorded_share * costs.path_count)
        self.judge(sums, size, next_range[0])
        self.parts = [Part(*next_range, CURRENT)]
        if self.is_given_up:
            return Guidance(self.settings, 0)
        threshold = self._budget.threshold(next_range[1])
        if next_range[0] >= self._rules.cache_early_samples:
            threshold = min(threshold, int(self._rules.cache_measured_share * 2**32))
        return self.complete(Guidance(self.settings, threshold))

    def keep(self, units: Sequence[UnitRecords]) -> None:
        """There is nobody else who learns."""

    def compare(self, unit: Unit, film: FilmTile, costs: UnitCosts) -> None:
        """There is nothing to compare."""

    def close(self) -> None:
        """There is nothing to end."""
