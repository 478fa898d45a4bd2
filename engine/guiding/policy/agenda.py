# SPDX-License-Identifier: GPL-3.0-or-later
"""Which question an iteration answers: those that come first in the list have precedence."""

from __future__ import annotations

from collections.abc import Sequence

from engine.guiding.policy.iteration import Iteration, guided_share
from engine.guiding.policy.questions.question import Question
from engine.guiding.policy.trial import ArmSamples
from engine.guiding.policy.way import Way
from engine.state.film import FilmTile
from engine.state.unit import CHALLENGER, CURRENT, Unit


class Agenda:
    """A render's questions.

    Parameters
    ----------
    questions : sequence of Question
        In the order of their precedence.

    Attributes
    ----------
    questions : list of Question
    arms : list of ArmSamples
        Those of the iteration in work.
    way : Way
        How its paths go.
    challenger : Way or None
        How those of the arm CHALLENGER go, if there are any.
    """

    def __init__(self, questions: Sequence[Question]) -> None:
        self.questions = list(questions)
        self.arms = [ArmSamples(0, 1, CURRENT)]
        self.way = Way()
        self.challenger: Way | None = None
        self._take_ways(None)

    def _take_ways(self, asking: Question | None) -> None:
        """Say how paths go, given the question that the iteration is for."""
        way = Way()
        for question in self._open:
            way = question.way(way)
        self.way = way
        has_challenger = asking is not None and any(arm_samples.arm == CHALLENGER for arm_samples in self.arms)
        self.challenger = asking.challenge(way) if asking is not None and has_challenger else None

    @property
    def _open(self) -> list[Question]:
        return [question for question in self.questions if not question.is_over]

    @property
    def other_arms(self) -> list[ArmSamples]:
        """Arms of the units that have no pixels of a trial; empty: all units have the same arms."""
        return [arm_samples for question in self._open for arm_samples in question.other_arms]

    @property
    def pixel_share(self) -> float:
        """Share of the pixels that have guided samples in the iteration in work, if any have."""
        return min((question.pixel_share for question in self._open), default=1.0)

    @property
    def guided_share(self) -> float:
        """Share of the samples of the iteration in work, of these pixels, that are guided."""
        return guided_share(self.arms)

    def way_of(self, arm: int) -> Way:
        """How the paths of an arm go."""
        return self.challenger if arm == CHALLENGER and self.challenger is not None else self.way

    def observe(self, unit: Unit, film: FilmTile, cost: float) -> None:
        """Take a finished unit's sums and its cost; no two threads at once."""
        for question in self._open:
            question.observe(unit, film, cost, is_aside=unit.is_aside)

    def conclude(self, iteration: Iteration) -> None:
        """Draw conclusions from an iteration."""
        for question in self.questions:
            # One may end those after it.
            if not question.is_over:
                question.conclude(iteration)

    def plan(self, iteration: Iteration) -> None:
        """Divide the next iteration for the first question that wants to compare in it."""
        asking = None
        arms: Sequence[ArmSamples] = ()
        is_waiting = False
        for question in self.questions:
            if question.is_over:
                continue
            is_kept = any(other.is_comparing for other in self._open if other is not question)
            wanted = question.plan(iteration, is_free=not (asking or is_waiting or is_kept))
            if wanted and asking is None:
                asking, arms = question, wanted
            is_waiting = is_waiting or not question.is_settled
        self.arms = list(arms) or [ArmSamples(*iteration.next_range, CURRENT)]
        self._take_ways(asking)
