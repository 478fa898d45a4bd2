# SPDX-License-Identifier: GPL-3.0-or-later
"""Guiding tried cautiously, in scenes with media, where it seldom pays (docs/decisions/guiding-in-media.md).

Nothing is learned before the fifth sample, and what regions promise decides with what comparisons show: their estimate
of the second moment without guiding over that with it.
"""

from __future__ import annotations

from collections.abc import Sequence

from engine.guiding.policy.costs import IterationCosts
from engine.guiding.policy.rules import RULES, Rules
from engine.guiding.records.unit_records import UnitRecords


class CautiousTrial:
    """What a cautious trial has not learned from yet, and what it makes of promises.

    Parameters
    ----------
    rules : Rules

    Attributes
    ----------
    is_promising : bool
        Guiding has not lost, and regions promise enough to guide all pixels.
    """

    def __init__(self, rules: Rules = RULES) -> None:
        self._rules = rules
        self.is_promising = False
        self._units: list[UnitRecords] = []
        self._samples = 0.0
        self._costs: IterationCosts | None = None

    def is_early(self, next_sample: int) -> bool:
        """Whether an iteration that `next_sample` follows is not to be learned from yet."""
        return next_sample < self._rules.cautious_samples

    def hold(self, units: Sequence[UnitRecords], samples: float, costs: IterationCosts) -> None:
        """Keep what an unguided iteration has left: records, samples a pixel, costs."""
        self._units += units
        self._samples += samples
        self._costs = costs if self._costs is None else self._costs + costs

    @property
    def held(self) -> list[UnitRecords]:
        """Records that nothing was learned from."""
        return self._units

    def release(
        self, units: Sequence[UnitRecords], costs: IterationCosts
    ) -> tuple[list[UnitRecords], float, IterationCosts]:
        """Records with those that were kept before them, samples a pixel that were kept, and costs of both."""
        kept, samples, before = self._units, self._samples, self._costs
        self._units, self._samples, self._costs = [], 0.0, None
        return [*kept, *units], samples, costs if before is None else before + costs

    def is_hopeless(self, promised: Sequence[float], efficiency: float) -> bool:
        """Whether a comparison has shown guiding to lose, and nothing is promised of what would be guided now.

        Parameters
        ----------
        promised : by kind of vertex
        efficiency : over unguided rendering, NaN where nothing was compared
        """
        return efficiency < 1.0 and max(promised) < self._rules.least_promise

    def weigh(self, promised: Sequence[float], efficiency: float) -> None:
        """Say whether all pixels are to be guided; parameters are those of `is_hopeless`."""
        self.is_promising = efficiency >= self._rules.least_of_cautious and min(promised) >= self._rules.sure_promise
