# SPDX-License-Identifier: GPL-3.0-or-later
"""Whether a network may weigh candidates: it is trained for a short while, and held-out records say what it is worth.

What resampling by the mixture saves says nothing of a network: on diffuse surfaces the mixture is nearly what
directions are drawn from, and saves nothing whatever the scene. So a network is trained wherever the render is long
enough to pay for that, and its figure (`engine.guiding.policy.off_policy`) decides.
"""

from __future__ import annotations

import math

from engine.guiding.models.predictors import Predictor
from engine.guiding.models.report import GuidingReport
from engine.guiding.policy.remaining_samples import RemainingSamples
from engine.guiding.policy.rules import RULES, Rules


class _NetworkTrial:
    """How long a network is on trial: from its first snapshot on, whenever the process that trains it came to that.

    Samples of a small picture by many threads pass faster than any network learns.
    """

    def __init__(self, remaining: RemainingSamples, rules: Rules, next_sample: int, step_count: int) -> None:
        self._remaining, self._rules = remaining, rules
        spent, left = remaining.spent(next_sample), remaining.left(next_sample)
        least = rules.network_least_seconds if remaining.uses_clock else rules.network_least_samples
        self._until = spent + max(rules.network_trial_share * left, least)
        self._at_most = spent + max(rules.network_longest_share * left, least)
        self._until_step = step_count + rules.network_trial_steps

    def is_over(self, next_sample: int, predictor: Predictor, look_count: int) -> bool:
        """Whether it has had its time, and has learned and been looked at as often as a verdict takes."""
        spent = self._remaining.spent(next_sample)
        has_learned = predictor.step_count >= self._until_step or not predictor.is_learning
        is_fair = has_learned and look_count >= self._rules.network_looks
        return spent >= self._until and (is_fair or spent >= self._at_most)


class Gate:
    """Trains what predicts for a bounded while, and keeps it or gives it up for good.

    Parameters
    ----------
    predictor : Predictor
    report : GuidingReport
    remaining : RemainingSamples
    judges_on : bool
        Whether it is still judged once it is kept: where nobody compares by rendered samples.
    rules : Rules
    """

    def __init__(
        self, predictor: Predictor, report: GuidingReport, remaining: RemainingSamples, *, judges_on: bool,
        rules: Rules = RULES,
    ) -> None:
        self._rules = rules
        self.predictor = predictor
        self._report = report
        self._remaining = remaining
        self._judges_on = judges_on
        self._trial: _NetworkTrial | None = None
        self._trained_until = math.inf
        self._is_kept = False
        self._evidence: list[float] = []
        report.is_network_gated = True

    @property
    def is_open(self) -> bool:
        """Whether the network may weigh candidates wherever that pays."""
        return self._is_kept and self.predictor.is_ready

    @property
    def wants_figure(self) -> bool:
        """Whether there is something to judge, and nothing is decided for good."""
        return self.predictor.is_ready and not self._report.network_stopped_at and self._is_undecided

    @property
    def _is_undecided(self) -> bool:
        return self._judges_on or not self._is_kept

    def begin_clock(self) -> None:
        """Tracing begins."""
        self._remaining.begin()

    def expect(self, samples: float) -> None:
        """Take how many samples all pixels are still to get on average, as far as their noise tells."""
        self._remaining.expected_samples = samples

    def begin(self, next_sample: int, region_count: int) -> None:
        """Begin training if the render is long enough; once guiding is settled. The field has so many regions."""
        is_early = next_sample < self._rules.network_from
        if self.predictor.has_begun or is_early or not self._remaining.is_long(next_sample):
            return
        self.predictor.begin(region_count)
        remaining = self._remaining
        whole = remaining.spent(next_sample) + remaining.left(next_sample)
        self._trained_until = self._rules.network_trained_share * whole

    def judge(self, next_sample: int, efficiency: float | None) -> None:
        """Take an iteration.

        Parameters
        ----------
        next_sample : int
        efficiency : float or None
            What held-out records promise of the image's efficiency with the network, over that without; None if nothing
            was asked (`wants_figure`).
        """
        # One that another render has learned is judged before it is trained on.
        if not (self.predictor.has_begun or self.predictor.is_ready) or self._report.network_stopped_at:
            return
        if self._trial is None and self.predictor.is_ready:
            self._trial = _NetworkTrial(self._remaining, self._rules, next_sample, self.predictor.step_count)
        if efficiency is not None and efficiency > 0.0:
            self._evidence = [*self._evidence, math.log(efficiency)][-self._rules.network_looks:]
        is_over = self._trial is not None and self._trial.is_over(next_sample, self.predictor, len(self._evidence))
        if self._is_kept and is_over and self._remaining.spent(next_sample) >= self._trained_until:
            self.predictor.close()
        if not self._is_undecided:
            return
        if len(self._evidence) == self._rules.network_looks:
            promise = self._report.network_promise = math.exp(sum(self._evidence) / self._rules.network_looks)
            if promise >= (self._rules.network_given_up if self._is_kept else self._rules.network_kept):
                self._is_kept = True
                return
        # It is still learning; but not for long.
        if is_over:
            self._give_up(next_sample)

    def _give_up(self, next_sample: int) -> None:
        self._is_kept = False
        self.predictor.drop()
        self._report.network_stopped_at = next_sample
