# SPDX-License-Identifier: GPL-3.0-or-later
"""Which question an iteration is for, and what several comparisons say together."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence

import numpy as np
import pytest

from engine.guiding.policy.agenda import Agenda
from engine.guiding.policy.costs import IterationCosts
from engine.guiding.policy.iteration import Iteration, Traced
from engine.guiding.policy.questions.question import Question
from engine.guiding.policy.rules import Rules
from engine.guiding.policy.staged import StagedVerdict, Verdict
from engine.guiding.policy.trial import ArmSamples, halves
from engine.guiding.policy.way import ImageState, Way
from engine.state.film import allocate_tile
from engine.state.unit import CHALLENGER, CURRENT, PLAIN, Unit


class Asking(Question):
    """Compares whenever it may, or always."""

    def __init__(self, name: str, *, insists: bool = False, wants: bool = True) -> None:
        self.name, self.insists, self.wants = name, insists, wants
        self.over = self.comparing = False
        self.settled = True
        self.was_free: list[bool] = []
        self.observed: list[bool] = []

    is_over = property(lambda self: self.over)  # type: ignore[assignment]
    is_settled = property(lambda self: self.settled)  # type: ignore[assignment]
    is_comparing = property(lambda self: self.comparing)  # type: ignore[assignment]

    def plan(self, iteration: Iteration, *, is_free: bool) -> Sequence[ArmSamples]:
        self.was_free.append(is_free)
        return halves(*iteration.next_range) if self.wants and (is_free or self.insists) else ()

    def challenge(self, way: Way) -> Way:
        return Way(rung=self.name)

    def observe(self, unit, film, cost, *, is_aside) -> None:
        self.observed.append(is_aside)


def iteration(first: int = 16, count: int = 16) -> Iteration:
    sums, costs = allocate_tile(1, 3), IterationCosts(Counter(), 0, 0, 0, 0, 0)
    traced = Traced([], 1.0, sums, (1, 1), costs, (first, count))
    return Iteration(traced, 1, [ArmSamples(0, 16, CURRENT)], False, 1.0, 16.0, ImageState(), False, 100.0, False, 0.0)


def asked(agenda: Agenda) -> str:
    """Whose challenger the next iteration renders, '' if nobody's."""
    agenda.plan(iteration())
    arms = [arm_samples.arm for arm_samples in agenda.arms]
    assert arms == ([CURRENT] if agenda.challenger is None else [CURRENT, CHALLENGER])
    return "" if agenda.challenger is None else agenda.challenger.rung


def test_the_first_that_wants_an_iteration_gets_it_and_others_are_told() -> None:
    one, two, three = questions = [Asking("one", wants=False), Asking("two"), Asking("three")]
    assert asked(Agenda(questions)) == "two"
    assert [question.was_free for question in (one, two, three)] == [[True], [True], [False]]
    two.over = True
    assert asked(Agenda(questions)) == "three"
    assert asked(Agenda([])) == ""


def test_what_insists_later_does_not_take_what_is_given() -> None:
    assert asked(Agenda([Asking("one"), Asking("two", insists=True)])) == "one"


def test_nothing_is_asked_behind_an_open_question() -> None:
    one, two = Asking("one", wants=False), Asking("two")
    one.settled = False
    assert asked(Agenda([one, two])) == "" and two.was_free == [False]


def test_a_comparison_of_several_iterations_is_not_broken_off() -> None:
    one, two = Asking("one"), Asking("two")
    two.comparing = True
    assert asked(Agenda([one, two])) == "two" and one.was_free == [False]


def test_units_without_guided_pixels_are_told_apart() -> None:
    question = Asking("one")
    agenda = Agenda([question])
    agenda.plan(iteration())
    for arm, is_aside in ((CURRENT, False), (CHALLENGER, False), (PLAIN, True), (PLAIN, False)):
        unit = Unit(np.zeros((1, 2), np.int32), np.zeros(1, np.int64), 16, 8, arm, is_aside=is_aside)
        agenda.observe(unit, allocate_tile(1, 3), 1.0)
    assert question.observed == [False, False, True, False]


@pytest.mark.parametrize(
    ("efficiencies", "verdicts"),
    [
        ([2.0], [Verdict.TAKEN]),
        ([0.5], [Verdict.DROPPED]),
        ([0.0], [Verdict.DROPPED]),
        ([1.2, 1.2], [Verdict.GO_ON, Verdict.TAKEN]),
        ([1.2, 0.7], [Verdict.GO_ON, Verdict.DROPPED]),
        # By their geometric mean.
        ([1.4, 0.9, 0.9], [Verdict.GO_ON, Verdict.GO_ON, Verdict.TAKEN]),
        ([1.4, 0.8, 0.9], [Verdict.GO_ON, Verdict.GO_ON, Verdict.DROPPED]),
        # What compares nothing says nothing.
        ([math.nan, 1.2, math.nan, 1.2], [Verdict.GO_ON, Verdict.GO_ON, Verdict.GO_ON, Verdict.TAKEN]),
    ],
)
def test_comparisons_decide_together(efficiencies: list[float], verdicts: list[Verdict]) -> None:
    staged = StagedVerdict(Rules(dropped=(0.8, 0.95, 1.03), taken=(1.5, 1.15, 1.03)))
    assert [staged.take(efficiency) for efficiency in efficiencies] == verdicts
