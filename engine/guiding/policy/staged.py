# SPDX-License-Identifier: GPL-3.0-or-later
"""What several comparisons of a challenger say together: take it, drop it, or go on comparing."""

from __future__ import annotations

import math
from enum import Enum

from engine.guiding.policy.rules import RULES, Rules


class Verdict(Enum):
    """How a challenger fared."""

    TAKEN = "taken"
    DROPPED = "dropped"
    GO_ON = "go on"


class StagedVerdict:
    """Efficiencies of a challenger over what is in use, comparison by comparison.

    Parameters
    ----------
    rules : Rules
        Its `taken` and `dropped` are of the geometric mean after so many comparisons.
    """

    def __init__(self, rules: Rules = RULES) -> None:
        self._rules = rules
        self._evidence: list[float] = []

    @property
    def mean(self) -> float:
        """Geometric mean of the efficiencies."""
        return math.exp(sum(self._evidence) / len(self._evidence))

    def take(self, efficiency: float) -> Verdict:
        """Take one more efficiency; NaN, nothing compared, says nothing."""
        if math.isnan(efficiency):
            return Verdict.GO_ON
        self._evidence.append(math.log(efficiency) if efficiency > 0.0 else -math.inf)
        stage = min(len(self._evidence), len(self._rules.taken)) - 1
        if self.mean >= self._rules.taken[stage]:
            return Verdict.TAKEN
        return Verdict.DROPPED if self.mean <= self._rules.dropped[stage] else Verdict.GO_ON
