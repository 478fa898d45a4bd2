# SPDX-License-Identifier: GPL-3.0-or-later
"""How much of a render is left, and whether that pays for training."""

from __future__ import annotations

import math
import time

from engine.guiding.policy.rules import RULES, Rules
from engine.settings import RenderSettings


class RemainingSamples:
    """What is left of a render.

    Parameters
    ----------
    settings : RenderSettings
    paths_per_sample : int
    uses_clock : bool
        Whether the image may depend on the clock.
    caution : float
        How many times as long what is left must be.
    rules : Rules

    Attributes
    ----------
    uses_clock : bool
    """

    def __init__(
        self, settings: RenderSettings, paths_per_sample: int, *, uses_clock: bool, caution: float = 1.0,
        rules: Rules = RULES,
    ) -> None:
        #: Mean samples of all pixels to come, as far as their noise tells; nothing is known before the first look.
        self.expected_samples = 0.0 if settings.use_adaptive_sampling else math.inf
        self._caution = caution
        self._rules = rules
        self._settings = settings
        self._paths_per_sample = paths_per_sample
        self.uses_clock = uses_clock
        self._started = time.perf_counter()

    def begin(self) -> None:
        """Tracing begins: what has gone before, as loading kernels, is no part of a time limit."""
        self._started = time.perf_counter()

    def samples_left(self, next_sample: int) -> float:
        """Samples a pixel that are still to come, as far as it is known."""
        left = float(self._settings.samples - next_sample)
        if self.uses_clock and self._settings.time_limit > 0.0:
            left = min(left, next_sample * (self._settings.time_limit / max(self._elapsed, 1e-9) - 1.0))
        return max(min(left, self.expected_samples), 0.0)

    def is_long(self, next_sample: int) -> bool:
        """Whether what is left is worth training for."""
        left = self.left(next_sample)
        if not self.uses_clock:
            return left * self._paths_per_sample >= self._rules.least_paths_left * self._caution
        return left >= self._rules.least_time_left * self._caution

    def spent(self, next_sample: int) -> float:
        """What the render has taken so far: seconds where the image may depend on the clock, else samples a pixel."""
        return self._elapsed if self.uses_clock else float(next_sample)

    def left(self, next_sample: int) -> float:
        """What it is still to take, in the unit of `spent`, as far as it is known."""
        left = self.samples_left(next_sample)
        return self._elapsed * left / max(next_sample, 1) if self.uses_clock else left

    @property
    def _elapsed(self) -> float:
        return time.perf_counter() - self._started
