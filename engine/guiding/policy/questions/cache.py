# SPDX-License-Identifier: GPL-3.0-or-later
"""Is the radiance cache worth it? Some paths measure what it lacks (docs/decisions/radiance-cache.md)."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from engine.guiding.models.residual import cached_noise, residual_error
from engine.guiding.policy.context import RenderContext
from engine.guiding.policy.costs import IterationCosts
from engine.guiding.policy.iteration import Iteration
from engine.guiding.policy.questions.question import Question
from engine.guiding.policy.rules import Rules
from engine.guiding.policy.standing import Standing
from engine.guiding.policy.way import Way
from engine.ris.orca import image_variance, pixel_weights, sample_variance


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
        Percentage of the pixels: so many of the largest and of the smallest are cut to the next.
    """
    gain = (square_gain - (known * (known + 2.0 * mean)).mean(axis=1)) * weights
    low, high = np.percentile(gain, (cut_percent, 100.0 - cut_percent))
    return float(np.clip(gain, low, high).mean())


def _surfaces_met(costs: IterationCosts) -> float:
    """Rays a path that look for the next surface. What else a path costs goes with them."""
    return costs.closest_count / max(costs.path_count, 1)


class Losses:
    """Whether the cache has lost, by all looks since it last paid.

    Parameters
    ----------
    rules : Rules
    """

    def __init__(self, rules: Rules) -> None:
        self._rules = rules
        self._product, self._look_count = 1.0, 0

    def decide(self, ratio: float) -> bool:
        """Take how many times the error a picture has at equal cost that it would have without; True: give it up."""
        self._product *= ratio
        self._look_count += 1
        if self._product <= 1.0:
            self._product, self._look_count = 1.0, 0
        is_clear = self._look_count >= self._rules.cache_looks and self._product > self._rules.cache_lost_slowly
        return is_clear or self._product > self._rules.cache_lost


class CacheQuestion(Question):
    """Whether the radiance cache pays: errors of the image with it and without, as measuring paths tell, times what
    paths cost. Costs are counted, so that the same render gives the same image everywhere: the first iteration, in
    which no path can end, says how long whole paths are.

    Parameters
    ----------
    context : RenderContext
        Those of a render with a radiance cache.
    standing : Standing
        The cache's: this says when it is given up.
    """

    def __init__(self, context: RenderContext, standing: Standing) -> None:
        self._report, self._standing, self._rules = context.report, standing, context.rules
        #: Of the paths, to measure what the cache lacks; and the sample from which on it is judged again.
        self._share = context.rules.cache_measured_share if context.settings.measures_cache else 0.0
        self._judge_from = 0.0
        self._losses = Losses(context.rules)
        #: Surfaces that a path met in the first iteration; before it is known, all paths count as whole.
        self._whole_length = 0.0

    @property
    def is_over(self) -> bool:
        return self._standing.is_over

    def way(self, way: Way) -> Way:
        return replace(way, uses_cache=True, measured_share=self._share)

    def conclude(self, iteration: Iteration) -> None:
        """Give the cache up where it makes more error.

        More paths measure where the noise of what they found, and what they have not found yet, is more than the noise
        of the cached image; else fewer.
        """
        sums, next_sample = iteration.sums, iteration.next_sample
        length = _surfaces_met(iteration.costs)
        if iteration.index == 1:
            self._whole_length = length
        if not len(sums.residual) or next_sample < self._judge_from:
            return
        rules = self._rules
        self._judge_from = rules.cache_again * next_sample
        weight = np.maximum(sums.weight, 1e-20)[:, None]
        mean = sums.radiance / weight
        weights = pixel_weights(mean.reshape(*iteration.traced.size, -1))
        # Variances are those of single samples: a noise threshold gives pixels different numbers of them.
        of_samples = weights * (sums.weight_squared / weight[:, 0] ** 2)
        cached = image_variance(sample_variance(mean, sums.square / weight), of_samples)
        error = residual_error(
            sums.residual / weight, sums.residual_square / weight[:, 0] ** 2, iteration.traced.size, weights,
            cached_noise(sums, iteration.traced.size),
        )
        # What is surely wrong in the large is wrong in details too, of which the estimate sees a part only. And the
        # cached image has less noise than its samples tell where they are well spread.
        seen = error.wide_squared if error.wide_squared > rules.cache_sure * error.wide_noise else 0.0
        is_too_few = error.noise + max(error.bias_squared, rules.cache_ahead * seen) > cached
        self._share = min(max(self._share * (2.0 if is_too_few else 0.5), rules.cache_measured_share), 1.0)
        self._report.cache_bias = math.sqrt(error.bias_squared)
        if next_sample < rules.cache_early_samples:
            return
        gain = _variance_gain(
            mean, sums.square_gain / weight[:, 0], error.known, of_samples, rules.cache_cut_percent
        )
        whole = cached + gain
        lacking = max(error.bias_squared - rules.cache_doubt * error.bias_noise, 0.0)
        error_ratio = (cached + error.noise + lacking) / max(whole, 1e-20)
        # Paths that are left to find all light are no shorter than others, where pixels have stopped or not.
        cost = rules.cache_cost * min(length / max(self._whole_length, 1e-9), 1.0)
        self._report.trials.append(
            f"radiance cache after {next_sample} samples: {error_ratio:.2f} of the error, {cost:.2f} of the cost"
        )
        said = float(((sums.ended / weight[:, 0]) ** 2 * weights).mean())
        is_wrong = seen > max(rules.cache_wrong * said, whole)
        if is_wrong or self._losses.decide(error_ratio * cost):
            self._standing.is_over = True
            self._report.cache_stopped_at = next_sample
