# SPDX-License-Identifier: GPL-3.0-or-later
"""Is resampling worth its cost here? The allocation says so, vertex by vertex."""

from __future__ import annotations

from engine.guiding.models.predictors import Predictor
from engine.guiding.models.report import GuidingReport
from engine.guiding.policy.costs import IterationCosts
from engine.ris.orca import FLOOR, PROBED_SHARE

#: Resampling is worth it, or not, once in so many iterations running this share of the vertices was worth several
#: candidates, or was not.
_PATIENCE = 2
LEAST_RESAMPLED = 0.1


class ResamplingWorth:
    """Counts iterations running in which enough vertices were worth several candidates, or were not."""

    def __init__(self) -> None:
        self._worth_count = self._worthless_count = 0

    @property
    def is_worth_it(self) -> bool:
        """Whether resampling has been worth it long enough."""
        return self._worth_count >= _PATIENCE

    @property
    def is_worthless(self) -> bool:
        """Whether it has not been for long enough."""
        return self._worthless_count >= _PATIENCE

    def count(self, costs: IterationCosts, recorded_share: float, *, is_probing: bool, is_in_use: bool = True) -> None:
        """Take an iteration.

        Parameters
        ----------
        is_probing : bool
            Only a share of the vertices of recorded paths had the choice.
        is_in_use : bool
            Whether what resampling is judged by is what it would be: else nothing speaks against it yet.
        """
        probed = recorded_share * PROBED_SHARE
        had_choice = probed if is_probing else 1.0
        # Those of recorded paths that only keep the estimates coming do not count.
        for_estimates = (float(FLOOR) - 1.0) * (probed if is_probing else recorded_share)
        resampled = (costs.several_vertices / costs.guided_vertices - for_estimates) / max(had_choice, 1e-6)
        is_worth_it = resampled >= LEAST_RESAMPLED
        self._worth_count = self._worth_count + 1 if is_worth_it else 0
        self._worthless_count = 0 if is_worth_it or not is_in_use else self._worthless_count + 1


class Gate:
    """Begins what predicts once resampling is worth it, and gives it up for good once it no longer is.

    Training takes time from every path. While nothing predicts, the mixture weighs candidates of recorded paths, and
    its estimates say what resampling may save.

    Parameters
    ----------
    predictor : Predictor
    report : GuidingReport
    """

    def __init__(self, predictor: Predictor, report: GuidingReport) -> None:
        self._predictor = predictor
        self._report = report
        self._worth = ResamplingWorth()
        report.waits_for_worth = True

    def weigh(self, costs: IterationCosts, recorded_share: float, next_sample: int, region_count: int) -> None:
        """Take an iteration that had guided vertices; the mixture field has `region_count` regions."""
        predictor = self._predictor
        if self._report.network_stopped_at:
            return
        # What it does is known once it weighs candidates.
        is_idle = predictor.has_begun and not predictor.is_ready
        self._worth.count(costs, recorded_share, is_probing=not predictor.is_ready, is_in_use=not is_idle)
        if not predictor.has_begun:
            if self._worth.is_worth_it:
                predictor.begin(region_count)
        elif self._worth.is_worthless:
            predictor.drop()
            self._report.network_stopped_at = next_sample
