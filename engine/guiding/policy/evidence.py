# SPDX-License-Identifier: GPL-3.0-or-later
"""What a render's samples say of its image, and what one iteration was: from units and sums to an `Iteration`."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from engine.guiding.policy.agenda import Agenda
from engine.guiding.policy.cautious import CautiousTrial
from engine.guiding.policy.iteration import Iteration, Traced
from engine.guiding.policy.remaining_samples import RemainingSamples
from engine.guiding.policy.sample_weights import SampleWeights
from engine.guiding.policy.standing import Standing
from engine.guiding.policy.trial import ComparedValues, NewestVariance
from engine.guiding.policy.way import ImageState
from engine.guiding.saved.learned import LearnedField
from engine.ris.orca import image_variance, pixel_weights
from engine.state.film import FilmTile
from engine.state.unit import PLAIN, Unit


class Evidence:
    """What is known of a render's image and of its iterations.

    Parameters
    ----------
    remaining : RemainingSamples
    ends_at : float
        Samples a pixel after which nobody will go by what is found; infinite: what is learned outlives the render.
    weights : SampleWeights
    standing : Standing
        Guiding's.
    newest : NewestVariance or None
        None: nothing is ever guided.
    compared : ComparedValues or None
        What variances are divided by until guiding is given up; None: the film.
    cautious : CautiousTrial or None
        What the first iterations wait in, where guiding is tried cautiously.

    Attributes
    ----------
    remaining : RemainingSamples
    weights : SampleWeights
    index : int
        Iterations so far.
    samples : float
        Guided ones a pixel that were learned from.
    image : ImageState
    """

    def __init__(
        self, remaining: RemainingSamples, ends_at: float, weights: SampleWeights, standing: Standing,
        newest: NewestVariance | None = None, compared: ComparedValues | None = None,
        cautious: CautiousTrial | None = None,
    ) -> None:
        self.remaining, self._ends_at, self.weights, self._standing = remaining, ends_at, weights, standing
        self._newest, self._compared, self._cautious = newest, compared, cautious
        self._start: LearnedField | None = None
        self.index = 0
        self.samples = 0.0
        self.image = self._before = ImageState()

    def resume(self, start: LearnedField, pixel_count: int) -> None:
        """Begin with what another render has found out: of the image nothing is known but how bright it was."""
        self._start, self.samples = start, start.samples
        weight = pixel_weights(np.full((1, 1, 1), max(start.brightness, 1e-20), np.float32))
        weights = np.full(pixel_count, weight[0], np.float32)
        self.image = ImageState(weights, start.variance, start.ray_count, start.brightness)

    def observe(self, unit: Unit, film: FilmTile, agenda: Agenda) -> None:
        """Take a finished unit's sums; no two threads at once."""
        if self._standing.is_over:
            return
        if self._compared is not None:
            weight = self.weights.seen(agenda.arms[0].first_sample, unit.arm)
            self._compared.add(unit.film_index, film.radiance, unit.sample_count, weight)
        if self._newest is not None and unit.arm != PLAIN and agenda.way.is_guided:
            self._newest.add(unit.film_index, film.radiance, film.square, unit.sample_count)

    def iteration(self, traced: Traced, agenda: Agenda, learning_seconds: float) -> Iteration:
        """What the iteration was that has just been traced; learning took so long the last time."""
        self.index += 1
        next_sample = traced.next_range[0]
        samples = sum(arm.sample_count for arm in agenda.arms) * agenda.guided_share * agenda.pixel_share
        cautious = self._cautious
        is_early = cautious is not None and cautious.is_early(next_sample)
        if is_early:
            assert cautious is not None
            cautious.hold(traced.units, sum(arm.sample_count for arm in agenda.arms), traced.costs)
            self.image = replace(self.image, weights=self._pixel_weights(traced))
        else:
            if cautious is not None:
                units, earlier_samples, costs = cautious.release(traced.units, traced.costs)
                traced, samples = replace(traced, units=units, costs=costs), samples + earlier_samples
            self.samples += samples
            self._before, self.image = self.image, self._look(traced)
        return Iteration(
            traced, self.index, tuple(agenda.arms), agenda.way.is_guided, agenda.pixel_share, samples, self.image,
            is_early, self.remaining.samples_left(next_sample), sum(traced.next_range) >= self._ends_at,
            learning_seconds,
        )

    def take_back(self) -> None:
        """Keep of the image what was known before the newest iteration, from which no guide learns, but its weights."""
        self.image = replace(self._before, weights=self.image.weights)

    def _pixel_weights(self, traced: Traced) -> np.ndarray:
        """Weights of the pixels' variances, float32 (P,)."""
        if self._compared is not None and not self._standing.is_over:
            return self._compared.weights(traced.size)
        return pixel_weights(_mean(traced.sums).reshape(*traced.size, -1))

    def _look(self, traced: Traced) -> ImageState:
        """What is known of the image by now; of its variance, as long as anything is guided."""
        weights, costs = self._pixel_weights(traced), traced.costs
        if self._newest is None or self._standing.is_over:
            return replace(self.image, weights=weights)
        variance = image_variance(self._newest.look(), weights)
        if self._start is not None and self.index == 1:
            # One sample a pixel has none.
            variance = max(variance, self._start.variance)
        brightness = float(_mean(traced.sums).mean(dtype=np.float64))
        return ImageState(weights, variance, costs.ray_count / max(costs.path_count, 1), brightness)


def _mean(sums: FilmTile) -> np.ndarray:
    """The image, float32 (P, C)."""
    return sums.radiance / np.maximum(sums.weight, 1e-20)[:, None]
