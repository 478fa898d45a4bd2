# SPDX-License-Identifier: GPL-3.0-or-later
"""Guiding tried cautiously, in scenes with media, where it seldom pays (docs/decisions/guiding-in-media.md).

Nothing is learned before the fifth sample, and what regions promise decides with what comparisons show: their estimate
of the second moment without guiding over that with it.
"""

from __future__ import annotations

from collections.abc import Sequence

from engine.guiding.policy.costs import IterationCosts
from engine.guiding.policy.trial import LEAST_OF_CAUTIOUS
from engine.guiding.records.of_unit import UnitRecords

#: Samples before anything is learned. To learn twice costs twice as much, and samples guided by what the first one has
#: left are worth little.
CAUTIOUS_SAMPLES = 4
#: What regions have to promise for guiding to be tried on where a comparison has shown it to lose: where it pays they
#: promise 1.2 to 3.7, where it does not 1 to 1.06.
_LEAST_PROMISE = 1.1
#: And what both surfaces and media have to promise for all pixels to be guided, though a comparison of a part of them
#: has shown little.
_SURE_PROMISE = 1.4


class CautiousTrial:
    """What a cautious trial has not learned from yet, and what it makes of promises.

    Attributes
    ----------
    is_promising : bool
        Guiding has not lost, and regions promise enough to guide all pixels.
    """

    def __init__(self) -> None:
        self.is_promising = False
        self._units: list[UnitRecords] = []
        self._samples = 0.0
        self._costs: IterationCosts | None = None

    def is_early(self, next_sample: int) -> bool:
        """Whether an iteration that `next_sample` follows is not to be learned from yet."""
        return next_sample < CAUTIOUS_SAMPLES

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
        return efficiency < 1.0 and max(promised) < _LEAST_PROMISE

    def weigh(self, promised: Sequence[float], efficiency: float) -> None:
        """Say whether all pixels are to be guided; parameters are those of `is_hopeless`."""
        self.is_promising = efficiency >= LEAST_OF_CAUTIOUS and min(promised) >= _SURE_PROMISE
