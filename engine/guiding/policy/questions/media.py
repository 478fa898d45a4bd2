# SPDX-License-Identifier: GPL-3.0-or-later
"""Does guiding pay on surfaces, and does it within media? In scenes that have both the one may pay and the other not.

The first comparison is of both together with unguided rendering (`engine.guiding.policy.questions.guiding`). Where they
win, each is left out in turn, by half of an iteration's samples, and stays out by the rule by which a finer method is
taken. Where they lose and much of the render is left, media alone are guided, then surfaces alone, before guiding is
given up.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from engine.guiding.policy.context import RenderContext
from engine.guiding.policy.iteration import Iteration
from engine.guiding.policy.learnables.regions import LearnedRegions
from engine.guiding.policy.questions.question import Question
from engine.guiding.policy.rules import RULES, Rules
from engine.guiding.policy.staged import StagedVerdict, Verdict
from engine.guiding.policy.standing import Standing
from engine.guiding.policy.trial import ArmSamples, GuidingTrial, halves
from engine.guiding.policy.way import BOTH, MEDIA, SURFACES, Way
from engine.state.film import FilmTile
from engine.state.unit import CHALLENGER, Unit


class MediaTrial:
    """What is guided of surfaces and media, and the comparisons that say so.

    Parameters
    ----------
    pixel_count : int
    rules : Rules

    Attributes
    ----------
    guided : str, one of BOTH, SURFACES and MEDIA: what the arm CURRENT guides
    challenger : str, what the arm CHALLENGER guides, '' if nothing is compared
    arms : list of ArmSamples, of the iteration while something is
    """

    def __init__(self, pixel_count: int, rules: Rules = RULES) -> None:
        self._rules = rules
        self.guided = BOTH
        self.challenger = ""
        self.arms: list[ArmSamples] = []
        self._pixel_count = pixel_count
        self._trial: GuidingTrial | None = None
        self._verdict = StagedVerdict(rules)
        #: What is left to be tried instead of both, and from which sample on.
        self._due = [SURFACES, MEDIA]
        self._not_before = 0
        self._is_comparing = False

    @property
    def is_running(self) -> bool:
        """Whether the iteration in work compares."""
        return self._is_comparing

    def plan(self, first: int, count: int, *, is_free: bool) -> None:
        """Divide the next iteration, if it is free to be divided."""
        self._is_comparing = False
        if not is_free or self.guided != BOTH or count < self._rules.least_compared:
            return
        if not self.challenger:
            if first < self._not_before:
                return
            self.challenger = self._due[0]
            self._verdict = StagedVerdict(self._rules)
        self.arms = halves(first, count)
        self._trial = GuidingTrial(self._pixel_count, rules=self._rules)
        self._is_comparing = True

    def compare(self, unit: Unit, film: FilmTile, cost: float) -> None:
        """Take a finished unit's sums and its cost; no two threads at once."""
        assert self._trial is not None
        self._trial.add_unit(unit, film, cost, unit.arm == CHALLENGER)

    def judge(self, weights: np.ndarray, next_sample: int) -> str:
        """After an iteration: draw the conclusion, if it compared.

        Returns
        -------
        str
            It in words, '' if there is none yet.
        """
        if not self._is_comparing or self._trial is None:
            return ""
        efficiency = self._trial.efficiency(weights)
        self._is_comparing, self._trial = False, None
        found = self._verdict.take(efficiency)
        if found is Verdict.GO_ON:
            return ""
        said = f"guiding {self.challenger} over {BOTH} {self._verdict.mean:.2f} at sample {next_sample}"
        if found is Verdict.TAKEN:
            self.guided = self.challenger
        else:
            self._due.append(self._due.pop(0))
            if self._due[0] == SURFACES:
                self._not_before = self._rules.again * next_sample
        self.challenger = ""
        return said

    def fall_back(self) -> bool:
        """Guide less, where all that was guided has lost against unguided rendering; False: nothing is left to try."""
        self.challenger = ""
        self._is_comparing, self._trial = False, None
        self.guided = {BOTH: MEDIA, MEDIA: SURFACES}.get(self.guided, "")
        return self.guided != ""


class MediaQuestion(Question):
    """Whether surfaces and media are guided together or one of them alone.

    Parameters
    ----------
    context : RenderContext
    standing : Standing
    regions : LearnedRegions

    Attributes
    ----------
    trial : MediaTrial
    """

    def __init__(self, context: RenderContext, standing: Standing, regions: LearnedRegions) -> None:
        self._context, self._standing, self._regions = context, standing, regions
        self.trial = MediaTrial(context.pixel_count, context.rules)

    @property
    def is_over(self) -> bool:
        return self._standing.is_over

    def observe(self, unit: Unit, film: FilmTile, cost: float, *, is_aside: bool) -> None:
        if self.trial.is_running:
            self.trial.compare(unit, film, cost)

    def conclude(self, iteration: Iteration) -> None:
        if self.trial.is_running and iteration.image.weights is not None:
            said = self.trial.judge(iteration.image.weights, iteration.next_sample)
            self._context.report.trials += [said] if said else []

    def plan(self, iteration: Iteration, *, is_free: bool) -> Sequence[ArmSamples]:
        knows_media = self._regions.knows_media
        is_free &= self._context.settings.guiding_trial and knows_media
        is_free &= not (self._standing.is_narrow or iteration.is_next_last)
        self.trial.plan(*iteration.next_range, is_free=is_free)
        if knows_media:
            self._context.report.guides = self.trial.guided
        return self.trial.arms if self.trial.is_running else ()

    def way(self, way: Way) -> Way:
        return replace(way, guides=self.trial.guided)

    def challenge(self, way: Way) -> Way:
        return replace(way, guides=self.trial.challenger)

    def fall_back(self) -> bool:
        """Guide less, where all that was guided has lost; False: there is nothing else to guide."""
        return self._regions.knows_media and self.trial.fall_back()
