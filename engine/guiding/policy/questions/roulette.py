# SPDX-License-Identifier: GPL-3.0-or-later
"""Is roulette by what was learned worth it, once guiding has lost? Before, it goes by that without being asked."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from engine.guiding.policy.context import RenderContext
from engine.guiding.policy.iteration import Iteration
from engine.guiding.policy.learnables.roulette import LearnedRoulette
from engine.guiding.policy.questions.question import Question
from engine.guiding.policy.rules import RULES, Rules
from engine.guiding.policy.standing import Standing
from engine.guiding.policy.trial import ArmSamples, GuidingTrial, halves
from engine.guiding.policy.way import Way
from engine.state.film import FilmTile
from engine.state.unit import CHALLENGER, Unit


def _add_unit(
    moments: GuidingTrial, unit: Unit, film: FilmTile, cost: float, *, is_challenger: bool, uses_clock: bool,
    rules: Rules,
) -> None:
    """Take a unit whose paths ended by the throughput, or (the challenger) by what was learned."""
    if is_challenger and not uses_clock:
        cost *= rules.roulette_counted_overhead
    moments.add_unit(unit, film, cost, is_challenger)


class RouletteOutsideTrial:
    """Samples of pixels that were not guided while guiding was tried on others: by the throughput before anything was
    known of surfaces, then by what was learned.

    Parameters
    ----------
    pixel_count : int
    uses_clock : bool
        Whether units cost seconds; else rays.
    rules : Rules

    Attributes
    ----------
    moments : GuidingTrial
    """

    def __init__(self, pixel_count: int, *, uses_clock: bool, rules: Rules = RULES) -> None:
        self._rules = rules
        self.moments = GuidingTrial(pixel_count, rules=rules)
        self._uses_clock = uses_clock
        #: Samples a pixel by either.
        self._samples = [0, 0]
        self._newest = -1

    def add(self, unit: Unit, film: FilmTile, cost: float, *, is_learned: bool) -> None:
        """Take a finished unit's sums and its cost; no two threads at once."""
        _add_unit(
            self.moments, unit, film, cost, is_challenger=is_learned, uses_clock=self._uses_clock, rules=self._rules
        )
        if unit.sample_first > self._newest:
            self._newest = unit.sample_first
            self._samples[int(is_learned)] += unit.sample_count

    @property
    def is_known(self) -> bool:
        """Whether there are enough samples of both to tell anything."""
        return min(self._samples) > 1


class RouletteTrial:
    """Half of the first iteration without guiding goes by what roulette has learned, half by the throughput alone.

    Where guiding was tried on a part of the pixels, the others have had samples by both: nothing need be rendered.

    Parameters
    ----------
    pixel_count : int
    samples : (int, int)
        First sample and samples a pixel of the iteration.
    uses_clock : bool
        Whether units cost seconds; else rays.
    outside_trial : RouletteOutsideTrial, optional
        What pixels have had that were not guided.
    rules : Rules

    Attributes
    ----------
    arms : list of ArmSamples, of the iteration
    is_running : bool, it is being compared
    is_known : bool, there is something to judge, though no iteration has compared
    is_won : bool, roulette goes by what was learned
    """

    def __init__(
        self, pixel_count: int, samples: tuple[int, int], *, uses_clock: bool,
        outside_trial: RouletteOutsideTrial | None = None, rules: Rules = RULES,
    ) -> None:
        self._rules = rules
        first, count = samples
        self.arms = halves(first, count)
        # Fewer samples tell nothing.
        self.is_running = count // 2 > 1
        self.is_won = True
        #: Whether there is a comparison to judge.
        self.is_known = outside_trial is not None and outside_trial.is_known
        self._moments = GuidingTrial(pixel_count, rules=rules)
        if outside_trial is not None and outside_trial.is_known:
            self.is_running = False
            self._moments = outside_trial.moments
        self._uses_clock = uses_clock

    def compare(self, unit: Unit, film: FilmTile, cost: float) -> None:
        """Take a finished unit's sums and its cost; no two threads at once."""
        _add_unit(
            self._moments, unit, film, cost, is_challenger=unit.arm == CHALLENGER, uses_clock=self._uses_clock,
            rules=self._rules,
        )

    def judge(self, weights: np.ndarray, next_sample: int) -> str:
        """Draw the conclusion, by the weights of the pixels' variances; returns it in words."""
        efficiency = self._moments.efficiency(weights)
        self.is_running = self.is_known = False
        # Written so that NaN, nothing compared, loses.
        self.is_won = efficiency >= self._rules.roulette_least_efficiency
        return f"learned roulette over OFF {efficiency:.2f} at sample {next_sample}"


class RouletteQuestion(Question):
    """Whether roulette goes by what was learned once nothing is guided any more.

    Parameters
    ----------
    context : RenderContext
    standing : Standing
        Guiding's.
    roulette : LearnedRoulette
    keeps_outside_trial : bool
        Whether samples of pixels that a trial leaves unguided are kept to judge by.
    uses_clock : bool
        Whether units cost seconds; else rays.
    cache : Standing, optional
        The radiance cache's: as long as paths end there, nobody asks.
    """

    def __init__(
        self, context: RenderContext, standing: Standing, roulette: LearnedRoulette, *, keeps_outside_trial: bool,
        uses_clock: bool, cache: Standing | None = None,
    ) -> None:
        self._cache = cache
        self._context, self._standing, self._roulette, self._uses_clock = context, standing, roulette, uses_clock
        self._trial: RouletteTrial | None = None
        self._outside_trial: RouletteOutsideTrial | None = None
        if keeps_outside_trial and context.pixel_count <= context.rules.roulette_most_pixels:
            self._outside_trial = RouletteOutsideTrial(context.pixel_count, uses_clock=uses_clock, rules=context.rules)

    @property
    def _has_cache(self) -> bool:
        return self._cache is not None and not self._cache.is_over

    @property
    def is_comparing(self) -> bool:
        return self._trial is not None and self._trial.is_running

    def observe(self, unit: Unit, film: FilmTile, cost: float, *, is_aside: bool) -> None:
        if self._trial is not None and self._trial.is_running:
            self._trial.compare(unit, film, cost)
        elif is_aside and self._outside_trial is not None and not self._standing.is_over:
            self._outside_trial.add(unit, film, cost, is_learned=self._roulette.is_ready)

    def conclude(self, iteration: Iteration) -> None:
        if self._trial is not None and self._trial.is_running:
            self._judge(self._trial, iteration)

    def _judge(self, trial: RouletteTrial, iteration: Iteration) -> None:
        if iteration.image.weights is not None:
            self._context.report.trials.append(trial.judge(iteration.image.weights, iteration.next_sample))

    def plan(self, iteration: Iteration, *, is_free: bool) -> Sequence[ArmSamples]:
        if not self._standing.is_over or self._trial is not None or self._has_cache:
            return ()
        trial = self._trial = RouletteTrial(
            self._context.pixel_count, iteration.next_range, uses_clock=self._uses_clock,
            outside_trial=self._outside_trial, rules=self._context.rules,
        )
        if trial.is_known:
            self._judge(trial, iteration)
        return trial.arms if trial.is_running else ()

    def way(self, way: Way) -> Way:
        is_won = self._trial is None or (self._trial.is_won and not self._trial.is_running)
        return replace(way, ends_by_learned=is_won)

    def challenge(self, way: Way) -> Way:
        return replace(way, ends_by_learned=True)
