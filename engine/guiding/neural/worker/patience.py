# SPDX-License-Identifier: GPL-3.0-or-later
"""When training that gains nothing rests, and when it wakes."""

from __future__ import annotations

import math

#: Gain on held-out rows from one check to the next, below which the check is idle.
_LEAST_IMPROVEMENT = 0.002
#: Idle checks running after which training rests.
_PATIENCE = 3


class Patience:
    """Counts checks that found no gain. New rows wake a training that rests for one check, which decides whether it
    goes on: they alone are no sign that there is more to learn.
    """

    def __init__(self) -> None:
        self._idle_checks = 0

    @property
    def is_resting(self) -> bool:
        """Whether so many checks running found no gain."""
        return self._idle_checks >= _PATIENCE

    def wake(self) -> None:
        """New rows came."""
        self._idle_checks = min(self._idle_checks, _PATIENCE - 1)

    def check(self, improvement: float) -> None:
        """Take what `Training.improvement` returned; infinity, where it had nothing to compare with, says nothing."""
        if improvement != math.inf:
            self._idle_checks = self._idle_checks + 1 if improvement < _LEAST_IMPROVEMENT else 0
