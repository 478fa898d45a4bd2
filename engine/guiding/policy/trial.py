# SPDX-License-Identifier: GPL-3.0-or-later
"""Does one way of rendering pay more than another in this image? Iterations render some samples by each, and compare.

What regions promise (`engine.guiding.models.selection`) does not add up along paths, and where light is easy to find
guiding costs more than it brings. The same pixels rendered both ways tell: efficiency is 1 / (variance x cost). Where
guiding loses, the rest of the image is rendered without. Both ways have the same expected image, and what is chosen
depends on samples already taken only.

Unguided samples do not change from iteration to iteration, so all there are count (`SampleMoments`): a few of them hide
their variance where it is in few bright ones. What guides does change, and its newest samples count.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from engine.guiding.policy.rules import RULES, Rules
from engine.kernels.sample_moments import add_moments, add_values, add_weighted
from engine.ris.orca import pixel_weights, sample_variance
from engine.state.film import FilmTile
from engine.state.unit import CHALLENGER, CURRENT, PLAIN, Unit

#: Where a trial begins anew: of what has just begun to learn, and of what is known well.
BEFORE_FIRST = 1
LAST_DOUBT = 5
#: Rounds of cutting: each brings a single outlier down to a twentieth.
_ROUNDS = 8


class ArmSamples(NamedTuple):
    """Samples of an iteration that are rendered alike, by one of the arms of `engine.state.unit`."""

    first_sample: int
    sample_count: int
    arm: int


def is_short(next_sample: int, samples_left: float, rules: Rules = RULES) -> bool:
    """Whether too few samples a pixel are left, after so many, to pay for trying what has not been found to pay."""
    return samples_left <= rules.short_rest * next_sample


def least_efficiency(
    iteration: int, next_sample: int, samples_left: float, *, is_part: bool = False, is_cautious: bool = False,
    rules: Rules = RULES,
) -> float:
    """Efficiency over unguided rendering from which on guiding goes on after an iteration that compared.

    Parameters
    ----------
    iteration : int
        Of `Rules.least_efficiency`.
    next_sample : int
        Samples a pixel so far, since it is tried.
    samples_left : float
    is_part : bool
        Whether a part of the pixels was compared.
    is_cautious : bool
        Whether guides have learned from unguided samples alone.
    rules : Rules
    """
    least = rules.least_efficiency[iteration]
    if not is_short(next_sample, samples_left, rules):
        has_time = samples_left > rules.long_rest * next_sample
        return min(least, rules.least_of_long_part) if is_part and not is_cautious and has_time else least
    if iteration > min(rules.least_efficiency) or not (is_part or is_cautious):
        return max(least, rules.least_of_short)
    return max(least, rules.least_of_cautious if is_cautious else rules.least_of_first_part)


def tried_weight(
    first_sample: int, *, is_guided: bool, is_cautious: bool = False, rules: Rules = RULES
) -> float:
    """Weight in the image of each sample of an iteration that begins with `first_sample`, where guiding is tried.

    It depends on no sample but by what was chosen: weights by measured variances would (docs/decisions/
    trial-and-choice.md). `is_cautious`: by guides that know little, or on a part of the pixels.
    """
    if first_sample == 0:
        return rules.first_weight
    if is_guided and is_cautious:
        return rules.cautious_weight
    return rules.guided_weight if is_guided and first_sample >= rules.guided_weight_from else 1.0


def arms(iteration: int, first: int, count: int, *, is_tried: bool, rules: Rules = RULES) -> list[ArmSamples]:
    """Parts of an iteration, for the trial against unguided rendering.

    Parameters
    ----------
    is_tried : bool
        Whether there is anything to compare.
    rules : Rules
    """
    if not is_tried or iteration not in rules.least_efficiency or count < rules.least_compared:
        return [ArmSamples(first, count, CURRENT)]
    return compared_arms(first, count)


def compared_arms(first: int, count: int) -> list[ArmSamples]:
    """Parts of an iteration, of four samples or more, that renders a few of them unguided."""
    plain = max(count // 4, 2)  # a variance takes two
    return [ArmSamples(first, count - plain, CURRENT), ArmSamples(first + count - plain, plain, PLAIN)]


def halves(first: int, count: int) -> list[ArmSamples]:
    """Parts of an iteration that renders half of its samples as a challenger has it."""
    half = count // 2
    return [ArmSamples(first, count - half, CURRENT), ArmSamples(first + count - half, half, CHALLENGER)]


class SampleMoments:
    """Variance of the samples of each pixel so far.

    Parameters
    ----------
    pixel_count : int
    """

    def __init__(self, pixel_count: int) -> None:
        self._count = np.zeros(pixel_count, np.int32)
        #: Sum of squared differences from the mean, averaged over channels.
        self._spread = np.zeros(pixel_count, np.float32)
        self._mean: np.ndarray | None = None

    def add(self, pixels: np.ndarray, radiance: np.ndarray, square: np.ndarray, sample_count: int) -> None:
        """Take a unit's sums. Of a pixel in the order of its samples.

        Parameters
        ----------
        pixels : int64 (P,), each once
        radiance, square : float32 (P or more, C), sums over `sample_count` samples
        """
        if self._mean is None:
            self._mean = np.zeros((len(self._count), radiance.shape[1]), np.float32)
        pixels = np.ascontiguousarray(pixels, np.int64)
        add_moments(self._count, self._mean, self._spread, pixels, radiance, square, sample_count)

    @property
    def is_known(self) -> np.ndarray:
        """Which pixels have two samples or more, bool (P,)."""
        return self._count > 1

    def variance(self) -> np.ndarray:
        """Variance of a sample, mean over channels, by pixel; NaN of fewer than two.

        Returns
        -------
        float64 (P,)
        """
        count = np.where(self._count > 1, self._count, np.nan)
        return self._spread / (count - 1.0)


class NewestVariance:
    """Variance of a guided sample by pixel, told by the newest of them: what guides gets better all the time.

    Moments of all samples, unguided ones and those of a guide that knew little among them, say too much where guiding
    helps most. Allocation and shares of light samples then take what a vertex adds for less than it is.

    Parameters
    ----------
    pixel_count : int
    rules : Rules
    """

    def __init__(self, pixel_count: int, rules: Rules = RULES) -> None:
        self._rules = rules
        #: Sums of the samples' weights and of their squares.
        self._weight = np.zeros(pixel_count, np.float32)
        self._weight_squared = np.zeros(pixel_count, np.float32)
        self._moments: np.ndarray | None = None
        #: Pixels with samples of the iteration in work: others have converged, and nothing more is spent on them.
        self._is_sampled = np.zeros(pixel_count, np.bool_)

    def add(self, pixels: np.ndarray, radiance: np.ndarray, square: np.ndarray, sample_count: int) -> None:
        """Take a unit's sums, as `SampleMoments.add`."""
        self._is_sampled[pixels] = True
        if self._moments is None:
            self._moments = np.zeros((2, len(self._weight), radiance.shape[1]), np.float32)
        pixels = np.ascontiguousarray(pixels, np.int64)
        add_weighted(self._weight, self._weight_squared, self._moments, pixels, radiance, square, sample_count)

    def look(self) -> np.ndarray:
        """Variance of a sample, mean over channels; called once an iteration, whose samples weigh less afterwards.

        Returns
        -------
        float64 (P,)
            NaN where fewer than two samples are known, and where the iteration had none.
        """
        if self._moments is None:
            return np.full(len(self._weight), np.nan)
        weight = self._weight.astype(np.float64)
        known = np.where(self._is_sampled & (weight > 0.0), weight, np.nan)[:, None]
        # The mean is taken from the same samples; about as many independent ones there are as weight^2 / squares.
        left = 1.0 - self._weight_squared / known[:, 0] ** 2
        variance = sample_variance(*(self._moments / known)) / np.where(left > self._rules.least_left, left, np.nan)
        self._moments *= np.float32(self._rules.variance_decay)
        self._weight *= np.float32(self._rules.variance_decay)
        self._weight_squared *= np.float32(self._rules.variance_decay**2)
        self._is_sampled[:] = False
        return variance


class ComparedValues:
    """The image that variances are divided by where the film's samples weigh by what they are.

    Unguided samples weigh less here: their bright paths would make the values that their variance is divided by, and
    hide where guiding helps (docs/decisions/trial-and-choice.md).

    Parameters
    ----------
    pixel_count : int
    """

    def __init__(self, pixel_count: int) -> None:
        self._weight = np.zeros(pixel_count, np.float32)
        self._total: np.ndarray | None = None

    def add(self, pixels: np.ndarray, radiance: np.ndarray, sample_count: int, weight: float) -> None:
        """Take a unit's sum over samples that weigh so much each, `pixels` int64 (P,), each once."""
        if self._total is None:
            self._total = np.zeros((len(self._weight), radiance.shape[1]), np.float32)
        pixels = np.ascontiguousarray(pixels, np.int64)
        add_values(self._weight, self._total, pixels, radiance, sample_count, np.float32(weight))

    def weights(self, size: tuple[int, int]) -> np.ndarray:
        """Weights of the pixels' variances, float32 (P,); the image has so many rows and columns."""
        total = np.zeros((len(self._weight), 1), np.float32) if self._total is None else self._total
        return pixel_weights((total / np.maximum(self._weight, 1e-20)[:, None]).reshape(*size, -1))


class GuidingTrial:
    """Moments of samples by the challenger (guiding, or a finer method) and by what it is to beat, and their costs.

    Parameters
    ----------
    pixel_count : int
    other : SampleMoments, optional
        Samples of what is to be beaten, where more of them are known than those of the iterations compared.
    rules : Rules
    """

    def __init__(
        self, pixel_count: int, other: SampleMoments | None = None, rules: Rules = RULES
    ) -> None:
        self._rules = rules
        self._moments = (other or SampleMoments(pixel_count), SampleMoments(pixel_count))
        self._costs: tuple[list[float], list[float]] = ([], [])
        self._paths = [0, 0]

    def add_unit(self, unit: Unit, film: FilmTile, cost: float, is_challenger: bool) -> None:
        """Take a finished unit's sums and its cost, in any unit; no two threads at once."""
        self.add(unit.film_index, film.radiance, film.square, unit.sample_count, is_challenger)
        self.add_cost(cost, unit.path_count, is_challenger)

    def add(
        self, pixels: np.ndarray, radiance: np.ndarray, square: np.ndarray, sample_count: int, is_challenger: bool
    ) -> None:
        """Take a unit's sums, as `SampleMoments.add`."""
        self._moments[int(is_challenger)].add(pixels, radiance, square, sample_count)

    def add_cost(self, cost: float, path_count: int, is_challenger: bool) -> None:
        """Take what a unit of so many paths cost, in any unit."""
        self._costs[int(is_challenger)].append(cost)
        self._paths[int(is_challenger)] += path_count

    def efficiency(self, weights: np.ndarray) -> float:
        """Efficiency of the challenger, 1 / (variance x cost), over the other's; NaN if nothing was compared.

        It is 0 if the challenger's samples vary without bounds, or not at all, as those of a black picture.

        Parameters
        ----------
        weights : float32 (P,), of the pixels' variances
        """
        known = np.logical_and(*(moments.is_known for moments in self._moments))
        # What is no number is more than any.
        variance = np.nan_to_num(np.stack([moments.variance() for moments in self._moments]), nan=np.inf, posinf=np.inf)
        if not known.any() or 0 in self._paths:
            return float("nan")
        variance = variance[:, known] * weights[known]
        total = variance.sum(axis=1)
        for _ in range(_ROUNDS):
            total = np.minimum(variance, self._rules.outlier_share * total[:, None]).sum(axis=1)
        # Exact sums, since units finish in any order.
        cost = [math.fsum(costs) / paths for costs, paths in zip(self._costs, self._paths, strict=True)]
        other, challenger = (total * cost).tolist()
        return other / challenger if 0.0 < challenger < math.inf else 0.0


def rehearse(channel_count: int) -> None:
    """Load (or compile) the kernels that comparing takes."""
    pixels, sums = np.zeros(1, np.int64), np.ones((1, channel_count), np.float32)
    for moments in (SampleMoments(1), NewestVariance(1)):
        moments.add(pixels, sums, sums, 1)
    ComparedValues(1).add(pixels, sums, 1, 1.0)
