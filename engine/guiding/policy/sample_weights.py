# SPDX-License-Identifier: GPL-3.0-or-later
"""What samples weigh in the image. It depends on no sample but by what was chosen."""

from __future__ import annotations

from engine.guiding.policy.iterations import iteration_weight
from engine.guiding.policy.rules import RULES, Rules
from engine.guiding.policy.trial import tried_weight
from engine.settings import RenderSettings
from engine.state.unit import PLAIN


class SampleWeights:
    """All samples weigh one: nothing that is learned makes later ones better."""

    def seen(self, first_sample: int, arm: int) -> float:
        """Weight by what was seen before the iteration that begins with `first_sample`."""
        return 1.0

    def of(self, first_sample: int, arm: int, *, is_guided: bool, is_part: bool) -> float:
        """Weight in the image of each sample of an arm.

        Parameters
        ----------
        first_sample : int
            The iteration's.
        arm : int
        is_guided : bool
            Whether the iteration's samples are guided, but for those of the arm PLAIN.
        is_part : bool
            Whether only a part of the pixels has guided ones.
        """
        return self.seen(first_sample, arm)


class GrowingWeights(SampleWeights):
    """Samples weigh by what was seen before them.

    Parameters
    ----------
    settings : RenderSettings
    known_samples : float
        A pixel, that the render knew about before its first.
    rules : Rules
    """

    def __init__(self, settings: RenderSettings, known_samples: float = 0.0, rules: Rules = RULES) -> None:
        self._settings, self._known_samples, self._rules = settings, known_samples, rules

    def seen(self, first_sample: int, arm: int) -> float:
        weight = iteration_weight(first_sample, self._settings, self._known_samples, self._rules)
        return weight * self._rules.plain_weight if arm == PLAIN else weight


class TrialWeights(GrowingWeights):
    """Samples weigh by whether they are guided, where guiding is tried.

    Parameters
    ----------
    settings : RenderSettings
    is_cautious : bool
        Whether guiding is tried cautiously.
    rules : Rules
    """

    def __init__(self, settings: RenderSettings, *, is_cautious: bool, rules: Rules = RULES) -> None:
        super().__init__(settings, rules=rules)
        self._is_cautious = is_cautious

    def of(self, first_sample: int, arm: int, *, is_guided: bool, is_part: bool) -> float:
        is_first = first_sample == self._rules.cautious_samples
        return tried_weight(
            first_sample, is_guided=is_guided and arm != PLAIN, is_cautious=self._is_cautious and (is_part or is_first),
            rules=self._rules,
        )
