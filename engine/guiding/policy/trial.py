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

from engine.kernels.sample_moments import add_moments, add_values, add_weighted
from engine.ris.orca import pixel_weights, sample_variance
from engine.state.unit import CURRENT, PLAIN

#: Iterations that compare, by index, and the least efficiency over unguided rendering with which guiding goes on after
#: them. It still learns, and at first gets the benefit of the doubt. In the end it has to be better by more than one:
#: samples of unguided rendering are better spread over a pixel, which the variance of single ones does not show
#: (docs/decisions/trial-and-choice.md).
LEAST_EFFICIENCY = {2: 0.5, 3: 0.5, 4: 0.8, 5: 1.0, 6: 1.3}
#: Where at most so many times the samples taken are left, nothing gets the benefit of the doubt: no later part of the
#: render could pay for it. A trial so costs the same share of a short render as of a long one.
SHORT_REST = 7
LEAST_OF_SHORT = 1.25
#: On a quarter of the pixels the first comparison knows few bright unguided samples, and shows guiding worse than it
#: is; but to go on costs little there.
LEAST_OF_FIRST_PART = 1.0
#: Where more than so many times the samples taken are left, going on on a quarter of the pixels costs a thirtieth of
#: the render at most, and the first comparisons have shown 0.4 where guiding came to 4 and 9
#: (docs/decisions/trial-and-choice.md).
LONG_REST = 15
LEAST_OF_LONG_PART = 0.25
#: Where guides have learned from unguided samples alone by then, as in media, they are worse than they will be. What
#: pays later had 0.85 and more of the efficiency in them, most of what does not 0.6 and less
#: (docs/decisions/guiding-in-media.md).
LEAST_OF_CAUTIOUS = 0.75
#: From which it guides all pixels: below, it may be luck.
SURE_OF_FIRST_PART = 1.5
#: Where a trial begins anew: of what has just begun to learn, and of what is known well.
BEFORE_FIRST = 1
LAST_DOUBT = 5
#: Efficiency that needs no more comparing for now; by two or three unguided samples a pixel it can be luck.
CLEAR_EFFICIENCY = {2: 2.0, 3: 2.0, 4: 1.35, 5: 1.35, 6: 1.35}
#: Weight in the image of a sample that was taken to compare, where weights grow with the samples seen
#: (`engine.guiding.policy.iterations.iteration_weight`): where guiding is worth having, it is a bad one.
PLAIN_WEIGHT = 0.5
#: Where guiding is tried an unguided sample weighs one, so that none is lost where guiding loses, and a guided one so
#: much from this sample on: until then guides have learned from the first sample alone. Where guiding wins that one is
#: worse than others by still more, and weighs half.
GUIDED_WEIGHT = 2.0
_GUIDED_WEIGHT_FROM = 4
_FIRST_WEIGHT = 0.5
#: Weight of guided samples where guiding is tried cautiously: where it loses they have two to four times the variance
#: of others, and where it wins they are few.
_CAUTIOUS_WEIGHT = 0.5
#: What an iteration's guided samples count for in the next iteration's variance. Those of a guide that knew little can
#: have a hundred times the variance, and must be forgotten sooner than what regions have learned.
_DECAY = 0.4
#: Of a variance about a mean of the same samples, the share that is not in that mean: a half with two, none with one.
_LEAST_LEFT = 0.4
#: Largest share of an image's variance that a single pixel may have. Nothing is left out: where guiding is worth the
#: most, unguided rendering hides its variance in few bright samples (docs/decisions/trial-and-choice.md).
_OUTLIER_SHARE = 0.05
#: Rounds of cutting: each brings a single outlier down to a twentieth.
_ROUNDS = 8


class Part(NamedTuple):
    """Samples of an iteration that are rendered alike, by one of the arms of `engine.state.unit`."""

    first_sample: int
    sample_count: int
    arm: int


def is_short(next_sample: int, samples_left: float) -> bool:
    """Whether too few samples a pixel are left, after so many, to pay for trying what has not been found to pay."""
    return samples_left <= SHORT_REST * next_sample


def least_efficiency(
    iteration: int, next_sample: int, samples_left: float, *, is_part: bool = False, is_cautious: bool = False
) -> float:
    """Efficiency over unguided rendering from which on guiding goes on after an iteration that compared.

    Parameters
    ----------
    iteration : int
        Of `LEAST_EFFICIENCY`.
    next_sample : int
        Samples a pixel so far.
    samples_left : float
    is_part : bool
        Whether a part of the pixels was compared.
    is_cautious : bool
        Whether guides have learned from unguided samples alone.
    """
    least = LEAST_EFFICIENCY[iteration]
    if not is_short(next_sample, samples_left):
        has_time = samples_left > LONG_REST * next_sample
        return min(least, LEAST_OF_LONG_PART) if is_part and not is_cautious and has_time else least
    if iteration > min(LEAST_EFFICIENCY) or not (is_part or is_cautious):
        return max(least, LEAST_OF_SHORT)
    return max(least, LEAST_OF_CAUTIOUS if is_cautious else LEAST_OF_FIRST_PART)


def tried_weight(first_sample: int, *, is_guided: bool, is_cautious: bool = False) -> float:
    """Weight in the image of each sample of an iteration that begins with `first_sample`, where guiding is tried.

    It depends on no sample but by what was chosen: weights by measured variances would (docs/decisions/
    trial-and-choice.md). `is_cautious`: by guides that know little, or on a part of the pixels.
    """
    if first_sample == 0:
        return _FIRST_WEIGHT
    if is_guided and is_cautious:
        return _CAUTIOUS_WEIGHT
    return GUIDED_WEIGHT if is_guided and first_sample >= _GUIDED_WEIGHT_FROM else 1.0


def parts(iteration: int, first: int, count: int, *, is_tried: bool) -> list[Part]:
    """Parts of an iteration, for the trial against unguided rendering.

    Parameters
    ----------
    is_tried : bool
        Whether there is anything to compare.
    """
    if not is_tried or iteration not in LEAST_EFFICIENCY or count < 4:
        return [Part(first, count, CURRENT)]
    return compared_parts(first, count)


def compared_parts(first: int, count: int) -> list[Part]:
    """Parts of an iteration, of four samples or more, that renders a few of them unguided."""
    plain = max(count // 4, 2)  # a variance takes two
    return [Part(first, count - plain, CURRENT), Part(first + count - plain, plain, PLAIN)]


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
        """Of which pixels there are two samples or more, bool (P,)."""
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
    """

    def __init__(self, pixel_count: int) -> None:
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
        variance = sample_variance(*(self._moments / known)) / np.where(left > _LEAST_LEFT, left, np.nan)
        self._moments *= np.float32(_DECAY)
        self._weight *= np.float32(_DECAY)
        self._weight_squared *= np.float32(_DECAY**2)
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
        """Of the pixels' variances, float32 (P,); the image has so many rows and columns."""
        total = np.zeros((len(self._weight), 1), np.float32) if self._total is None else self._total
        return pixel_weights((total / np.maximum(self._weight, 1e-20)[:, None]).reshape(*size, -1))


class GuidingTrial:
    """Moments of samples by the challenger (guiding, or a finer method) and by what it is to beat, and their costs.

    Parameters
    ----------
    pixel_count : int
    other : SampleMoments, optional
        Of what is to be beaten, where more of its samples are known than those of the iterations compared.
    """

    def __init__(self, pixel_count: int, other: SampleMoments | None = None) -> None:
        self._moments = (other or SampleMoments(pixel_count), SampleMoments(pixel_count))
        self._costs: tuple[list[float], list[float]] = ([], [])
        self._paths = [0, 0]

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
            total = np.minimum(variance, _OUTLIER_SHARE * total[:, None]).sum(axis=1)
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
