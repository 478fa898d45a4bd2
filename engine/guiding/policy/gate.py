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
from engine.guiding.policy.horizon import Horizon

#: Training begins after so many samples a pixel: before, records are few, and what guides changes with each iteration.
FIRST_SAMPLE = 15
#: A network is on trial for this share of what is left, but for as many samples as it takes to learn and be judged.
TRIAL_SHARE = 0.1
_LEAST_TRIAL = 64
#: Training of a network that is kept ends after this share of the render, as the paper's mixtures have it (Dong et al.
#: 2023, section 5.2): what it has learned has to pay for itself in what is left.
TRAINED_SHARE = 0.25
#: Figures that decide together: each is of one iteration's records.
LOOKS = 3
#: Mean promised efficiency, over going on without, from which on a network is kept, and below which it is given up
#: again. A promise is an estimate, and training takes time from all paths.
KEPT = 1.05
GIVEN_UP = 1.02


class Gate:
    """Trains what predicts for a bounded while, and keeps it or gives it up for good.

    Parameters
    ----------
    predictor : Predictor
    report : GuidingReport
    horizon : Horizon
    judges_on : bool
        Whether it is still judged once it is kept: where nobody compares by rendered samples.
    """

    def __init__(self, predictor: Predictor, report: GuidingReport, horizon: Horizon, *, judges_on: bool) -> None:
        self.predictor = predictor
        self._report = report
        self._horizon = horizon
        self._judges_on = judges_on
        self._until = self._trained_until = math.inf
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
        self._horizon.begin()

    def expect(self, samples: float) -> None:
        """Take how many samples all pixels are still to get on average, as far as their noise tells."""
        self._horizon.expected_samples = samples

    def begin(self, next_sample: int, region_count: int) -> None:
        """Begin training if the render is long enough; once guiding is settled. The field has so many regions."""
        if self.predictor.has_begun or next_sample < FIRST_SAMPLE or not self._horizon.is_long(next_sample):
            return
        self.predictor.begin(region_count)
        left = self._horizon.samples_left(next_sample)
        self._until = next_sample + max(TRIAL_SHARE * left, _LEAST_TRIAL)
        self._trained_until = max(self._until, TRAINED_SHARE * (next_sample + left))

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
        if self._is_kept and next_sample >= self._trained_until:
            self.predictor.close()
        if efficiency is not None and efficiency > 0.0:
            self._evidence = [*self._evidence, math.log(efficiency)][-LOOKS:]
        if not self._is_undecided:
            return
        if len(self._evidence) == LOOKS:
            promise = self._report.network_promise = math.exp(sum(self._evidence) / LOOKS)
            if promise >= (GIVEN_UP if self._is_kept else KEPT):
                self._is_kept = True
                return
        # It is still learning; but not for long.
        if next_sample >= self._until:
            self._give_up(next_sample)

    def _give_up(self, next_sample: int) -> None:
        self._is_kept = False
        self.predictor.drop()
        self._report.network_stopped_at = next_sample
