# SPDX-License-Identifier: GPL-3.0-or-later
"""The rungs of AUTO: which methods to compare with the one in use, and when what they need is made.

A finer method is offered where resampling promises to pay, once those before it have been compared, and when its
predictor is ready. What it needs is made then, and dropped as long as there is no use for it.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence

from engine.guiding.models.predictors import Predictor
from engine.guiding.models.regions import RegionModels
from engine.guiding.policy.choice import Choice
from engine.methods import METHODS
from engine.settings import RenderSettings

#: What a render must still take for training beside it to begin at all: seconds or, without a clock, paths.
_LEAST_TIME_LEFT = 20.0
_LEAST_PATHS_LEFT = 6e6


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
    paths_per_sample : int
    uses_clock : bool
        Whether the image may depend on the clock.
    """

    def __init__(
        self, settings: RenderSettings, rungs: Sequence[str], predictors: Mapping[str, Predictor], choice: Choice,
        paths_per_sample: int, uses_clock: bool,
    ) -> None:
        self._settings = settings
        self._rungs = tuple(rungs)
        self._predictors = predictors
        self._choice = choice
        self._paths_per_sample = paths_per_sample
        self._uses_clock = uses_clock
        self._started = time.perf_counter()

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

    def offers(self, next_sample: int, is_worth_it: bool, regions: RegionModels) -> list[str]:
        """Methods to compare with the one in use, in the order in which to try them.

        Parameters
        ----------
        next_sample : int
        is_worth_it : bool
            Whether enough vertices were worth several candidates.
        """
        choice, coarsest = self._choice, self._rungs[0]
        is_promising = is_worth_it or choice.rung != coarsest or choice.challenger != ""
        if not self.is_auto or not is_promising:
            return []
        offers = []
        for rung in self._rungs[1:]:
            predictor = self._predictors[METHODS[rung].predictor]
            if self._prepare(rung, predictor, next_sample, regions):
                offers.append(rung)
            if not choice.has_tried(rung):
                break
        return [*offers, coarsest]

    def _prepare(self, rung: str, predictor: Predictor, next_sample: int, regions: RegionModels) -> bool:
        """Make or drop what a rung needs; whether it can be tried."""
        if not METHODS[rung].predictor:
            return True
        if not self._choice.has_use_for(rung, next_sample):
            predictor.drop()
            return False
        if not predictor.has_begun and (not predictor.is_asynchronous or self._is_long(next_sample)):
            predictor.begin(regions.mixture.region_count)
            return False
        return predictor.is_ready

    def _is_long(self, next_sample: int) -> bool:
        """Whether what is left of the render is worth training for."""
        samples_left = self._settings.samples - next_sample
        if not self._uses_clock:
            return samples_left * self._paths_per_sample >= _LEAST_PATHS_LEFT
        elapsed = time.perf_counter() - self._started
        left = elapsed * samples_left / max(next_sample, 1)
        if self._settings.time_limit > 0.0:
            left = min(left, self._settings.time_limit - elapsed)
        return left >= _LEAST_TIME_LEFT
