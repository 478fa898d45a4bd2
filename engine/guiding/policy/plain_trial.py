# SPDX-License-Identifier: GPL-3.0-or-later
"""Guiding compared with unguided rendering: at first, and again later on, unless there is no doubt.

Some iterations render a part of their samples without guiding, and efficiencies, 1 / (variance x cost), are compared
(`engine.guiding.policy.trial`). Both have the same expected image, and what is chosen depends on samples already taken
only.
"""

from __future__ import annotations

import math

import numpy as np

from engine.guiding.policy import trial
from engine.guiding.policy.rules import RULES, Rules
from engine.guiding.policy.trial import ArmSamples, GuidingTrial, SampleMoments
from engine.guiding.saved.learned import LOST, OPEN, WON
from engine.state.film import FilmTile
from engine.state.unit import CURRENT, Unit


class PlainTrial:
    """Where the comparison of guiding with unguided rendering stands.

    Parameters
    ----------
    pixel_count : int
    tries_plain : bool
        Whether to compare at all.
    rules : Rules
    plain : SampleMoments, optional
        All unguided samples of the image so far, where there are any.

    Attributes
    ----------
    has_lost : bool, the last iteration showed unguided rendering to be better
    efficiency : float, over unguided rendering when last compared
    """

    def __init__(
        self, pixel_count: int, *, tries_plain: bool, rules: Rules = RULES, plain: SampleMoments | None = None
    ) -> None:
        self._rules = rules
        self.has_lost = False
        self.efficiency = math.nan
        self._pixel_count = pixel_count
        self._tries_plain = tries_plain
        #: Where the trial against unguided rendering stands.
        self._iteration = 0
        #: The sample from which on it is tried: what is left is compared with what trying has taken.
        self._begun_at = 0
        self._compared_at = 0
        self._has_won = False
        #: Whether the newest comparison was of a part of the pixels.
        self._was_part = False
        self._least_paying = rules.least_of_short
        #: What is being compared, and whether it is in the iteration in work.
        self._trial: GuidingTrial | None = None
        self._is_comparing = False
        #: All unguided samples of the image, and whether those of the iteration in work are, whatever their arm.
        self._plain = plain or SampleMoments(pixel_count)
        self._knows_something = False
        #: Later comparisons with unguided rendering: whether this iteration takes part in one, from which sample on the
        #: next is due, and the overheads of its iterations so far.
        self._looks_again = False
        self._look_from = 0
        self._overheads: list[float] = []

    @property
    def is_settled(self) -> bool:
        """Whether guiding has been found better than unguided rendering, or nobody asks."""
        return not self._tries_plain or self._has_won or self._iteration > max(self._rules.least_efficiency)

    @property
    def is_paying(self) -> bool:
        """Whether the newest comparison has shown guiding to pay, by as much as such a one has to."""
        return self.efficiency >= self._least_paying

    def restart(self, iteration: int) -> None:
        """Compare with unguided rendering again, from a stage of the trial on: something else guides now."""
        self._iteration = iteration
        self._has_won = False
        self._trial = None
        self._overheads = []

    def successor(self, next_sample: int) -> PlainTrial:
        """The trial of what takes over at a sample from what was tried so far, and has just begun to guide. This one
        rests.
        """
        following = PlainTrial(
            self._pixel_count, tries_plain=self._tries_plain, rules=self._rules, plain=self._plain
        )
        following.restart(trial.BEFORE_FIRST)
        following._begun_at = next_sample
        self._trial, self._is_comparing, self._looks_again, self._overheads = None, False, False, []
        return following

    @property
    def verdict(self) -> str:
        """What comparing guiding with unguided rendering has said so far, one of `engine.guiding.saved.VERDICTS`."""
        if self.has_lost:
            return LOST
        return WON if self._tries_plain and self.is_settled else OPEN

    def resume(self, verdict: str, efficiency: float) -> None:
        """Begin with something to guide by, and with what another render has found out about it.

        It is never trusted blindly, for another view may be another matter: what won is looked at again later on.
        """
        if self._tries_plain and verdict == WON:
            self._has_won, self.efficiency, self._look_from = True, efficiency or math.nan, self._rules.look_again_from

    def compare(self, unit: Unit, film: FilmTile, cost: float, *, is_aside: bool) -> None:
        """Take a finished unit's sums and its cost, in any unit; no two threads at once.

        `is_aside`: none of its pixels is guided in the iteration in work.
        """
        sums = unit.film_index, film.radiance, film.square, unit.sample_count
        if is_aside:
            self._plain.add(*sums)
        elif self._is_comparing and self._trial is not None:
            self._trial.add_unit(unit, film, cost, unit.arm == CURRENT)
        elif self._tries_plain and not self._knows_something:
            self._plain.add(*sums)

    def judge(
        self, weights: np.ndarray, next_sample: int, overhead: float, samples_left: float = math.inf, *,
        is_part: bool = False, is_cautious: bool = False, is_learning: bool = False,
    ) -> bool:
        """After an iteration: draw the conclusion, if it compared; returns whether there is one.

        Parameters
        ----------
        weights : float32 (P,), of the pixels' variances
        next_sample : int
        overhead : float
            Cost of what the arm compared needs besides tracing, as a share of that.
        samples_left : float
            Samples a pixel to come, as far as it is known.
        is_part : bool
            Whether a part of the pixels was compared.
        is_cautious : bool
            As of `engine.guiding.policy.trial.least_efficiency`.
        is_learning : bool
            Whether what guides has hardly learned yet, however many iterations are over: as much is asked of it as
            after the first comparison.
        """
        if not is_learning or self._iteration < min(self._rules.least_efficiency):
            self._iteration += 1
        self.has_lost = False
        compared, self._trial = self._trial, None
        if compared is None:
            return False
        if self._looks_again:
            self._overheads.append(overhead)
            if len(self._overheads) < self._rules.looks:
                self._trial = compared
                return False
            overhead = sum(self._overheads) / self._rules.looks
            self._overheads = []
        efficiency = compared.efficiency(weights) / (1.0 + overhead)
        if self._looks_again:
            return self._look(efficiency, next_sample)
        if self.efficiency >= self._rules.least_of_short and not self._was_part:
            # It has paid once: what there is to lose is small, however little is left. A part can be lucky.
            samples_left = math.inf
        self.efficiency = efficiency
        self._has_won = efficiency >= self._rules.clear_efficiency[self._compared_at]
        least = trial.least_efficiency(
            self._compared_at, next_sample - self._begun_at, samples_left, is_part=is_part, is_cautious=is_cautious,
            rules=self._rules,
        )
        # Written so that NaN, nothing compared, goes on.
        self.has_lost = efficiency < least
        self._was_part = is_part
        is_first_part = is_part and self._compared_at == min(self._rules.least_efficiency)
        self._least_paying = self._rules.sure_of_first_part if is_first_part else self._rules.least_of_short
        if self.is_settled:
            self._look_from = self._rules.again * next_sample
        return True

    def _look(self, efficiency: float, next_sample: int) -> bool:
        """Take a later comparison with unguided rendering; returns whether it said anything."""
        if math.isnan(efficiency):
            return False
        self.efficiency = efficiency
        self.has_lost = efficiency < self._rules.least_later
        self._look_from = self._rules.again * next_sample
        return True

    def plan(
        self, first: int, count: int, *, knows_something: bool = True, is_whole: bool = True, is_last: bool = False,
        is_free: bool = True,
    ) -> list[ArmSamples]:
        """Parts of the next iteration, if it is to compare; else none.

        Parameters
        ----------
        first, count : int
            Its samples.
        knows_something : bool
            Whether there is anything to guide by.
        is_whole : bool
            Whether its samples lie in all of u: within a stratum they vary less than the unguided ones of all strata,
            and those of the iteration alone are compared.
        is_last : bool
            Whether nobody will go by what the iteration finds, or what so few pixels say is luck.
        is_free : bool
            Whether nothing else is being compared, so that it is time for a later look.
        """
        self._knows_something = knows_something
        self._is_comparing = self._looks_again = False
        if is_last:
            self._trial, self._overheads = None, []
            return []
        is_tried = self._tries_plain and not self._has_won and knows_something
        arms = trial.arms(self._iteration, first, count, is_tried=is_tried, rules=self._rules)
        if len(arms) > 1:
            self._compared_at = self._iteration
        elif is_free and self.is_settled and count >= self._rules.least_compared and self._is_due(first):
            self._looks_again = True
            arms = trial.compared_arms(first, count)
        self._is_comparing = len(arms) > 1
        if self._is_comparing and self._trial is None:
            self._trial = GuidingTrial(self._pixel_count, self._plain if is_whole else None, self._rules)
        return arms if self._is_comparing else []

    def _is_due(self, first: int) -> bool:
        """Whether to compare with unguided rendering again."""
        # Written so that NaN, nothing compared, is not due.
        return self._tries_plain and first >= self._look_from and self.efficiency < self._rules.sure
