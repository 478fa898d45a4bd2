# SPDX-License-Identifier: GPL-3.0-or-later
"""The rungs of AUTO: which methods to compare with the one in use, and when what they need is made.

A finer method is offered where resampling promises to pay, once those before it have been compared, and when its
predictor is ready. What it needs is made then, and dropped as long as there is no use for it. A network is offered
where its gate is open, whatever resampling by coarser predictors promises.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from engine.guiding.models.predictors import Predictor
from engine.guiding.models.regions import RegionModels
from engine.guiding.policy.choice import Choice
from engine.guiding.policy.gate import Gate
from engine.guiding.policy.rules import RULES, Rules
from engine.methods import METHODS
from engine.settings import RenderSettings


class Ladder:
    """Methods of a render, coarsest first.

    Parameters
    ----------
    settings : RenderSettings
    rungs : sequence of str
        More than one: a render by AUTO.
    predictors : mapping of str to Predictor
        By `Method.predictor`.
    choice : Choice
    rules : Rules
    """

    def __init__(
        self, settings: RenderSettings, rungs: Sequence[str], predictors: Mapping[str, Predictor], choice: Choice,
        rules: Rules = RULES,
    ) -> None:
        self._rules = rules
        self._settings = settings
        self._rungs = tuple(rungs)
        self._predictors = predictors
        self._choice = choice

    @property
    def is_auto(self) -> bool:
        """Whether methods are compared."""
        return len(self._rungs) > 1

    @property
    def counts_worth(self) -> bool:
        """Whether allocation judges resampling: not where a number of candidates is asked for."""
        return self._settings.candidate_allocation == "ORCA"

    @property
    def is_probing(self) -> bool:
        """Whether the coarsest method tries allocation in this iteration, to judge resampling by."""
        choice = self._choice
        return self.is_auto and self.counts_worth and choice.rung == self._rungs[0] and not choice.challenger

    def offers(self, next_sample: int, is_worth_it: bool, regions: RegionModels, gate: Gate | None) -> list[str]:
        """Methods to compare with the one in use, in the order in which to try them.

        Parameters
        ----------
        next_sample : int
        is_worth_it : bool
            Whether enough vertices were worth several candidates.
        regions : RegionModels
        gate : Gate or None
            Of the network.
        """
        choice, coarsest = self._choice, self._rungs[0]
        if not self.is_auto:
            return []
        is_promising = is_worth_it or choice.rung != coarsest or choice.challenger != ""
        offers = []
        is_reached = is_promising
        for rung in self._rungs[1:]:
            predictor = self._predictors[METHODS[rung].predictor]
            if predictor.is_asynchronous:
                is_ready = self._keep(rung, predictor, next_sample) and gate is not None and gate.is_open
            else:
                is_ready = is_reached and self._prepare(rung, predictor, next_sample, regions)
            if is_ready:
                offers.append(rung)
            is_reached = is_reached and choice.has_tried(rung)
        return [*offers, coarsest] if offers or is_promising else []

    def _keep(self, rung: str, predictor: Predictor, next_sample: int) -> bool:
        """Whether there is a use for what a rung needs; else drop it."""
        if self._choice.has_use_for(rung, next_sample):
            return True
        predictor.drop()
        return False

    def _prepare(self, rung: str, predictor: Predictor, next_sample: int, regions: RegionModels) -> bool:
        """Make or drop what a rung needs; whether it can be tried."""
        if not METHODS[rung].predictor:
            return True
        if not self._keep(rung, predictor, next_sample):
            return False
        if not predictor.has_begun:
            predictor.begin(regions.mixture.region_count)
            return False
        return predictor.is_ready and predictor.update_count >= self._rules.table_updates
