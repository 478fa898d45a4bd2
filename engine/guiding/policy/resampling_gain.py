# SPDX-License-Identifier: GPL-3.0-or-later
"""Is resampling worth its cost here? The allocation says so, vertex by vertex."""

from __future__ import annotations

from engine.guiding.policy.costs import IterationCosts
from engine.guiding.policy.rules import RULES, Rules
from engine.ris.orca import FLOOR, PROBED_SHARE


class ResamplingGain:
    """Counts iterations running in which enough vertices were worth several candidates.

    Parameters
    ----------
    rules : Rules
    """

    def __init__(self, rules: Rules = RULES) -> None:
        self._rules = rules
        self._worth_count = 0

    @property
    def is_worth_it(self) -> bool:
        """Whether resampling has been worth it long enough."""
        return self._worth_count >= self._rules.resampling_patience

    def count(self, costs: IterationCosts, recorded_share: float) -> None:
        """Take an iteration with guided vertices, in which a share of those of recorded paths had the choice."""
        probed = recorded_share * PROBED_SHARE
        # Those that only keep the estimates coming do not count.
        for_estimates = (float(FLOOR) - 1.0) * probed
        resampled = (costs.several_vertices / costs.guided_vertices - for_estimates) / max(probed, 1e-6)
        self._worth_count = self._worth_count + 1 if resampled >= self._rules.least_resampled else 0
