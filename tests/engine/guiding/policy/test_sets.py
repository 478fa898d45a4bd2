# SPDX-License-Identifier: GPL-3.0-or-later
"""What renders learn and ask, and that a new learnable or a new question is a class and a line."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from engine.guiding.policy.guidance import Guidance
from engine.guiding.policy.iteration import Iteration
from engine.guiding.policy.learnables.learnable import Learnable
from engine.guiding.policy.questions.question import Question
from engine.guiding.policy.sets import make_learner
from engine.guiding.policy.staged import StagedVerdict, Verdict
from engine.guiding.policy.trial import ArmSamples, GuidingTrial, halves
from engine.guiding.policy.way import ImageState, Way
from engine.render import render_loop
from engine.settings import RenderSettings
from engine.state.film import FilmTile
from engine.state.unit import CHALLENGER, Unit
from tests.helpers.seeded_renders import render
from tests.helpers.small_scenes import pit_scene

SIZE = (32, 32)


class Reach(Learnable):
    """How far the scene's records reach; guided paths weigh pixels by nothing once that is known."""

    def __init__(self) -> None:
        self.reach = 0.0

    def learn(self, iteration: Iteration) -> None:
        position = iteration.records.position[: iteration.row_count]
        self.reach = max(self.reach, float(np.abs(position).max(initial=0.0)))

    def complete(self, guidance: Guidance, way: Way, image: ImageState) -> Guidance:
        return replace(guidance, record_threshold=1 << 32) if self.reach else guidance


class Sameness(Question):
    """Is what is rendered worth as much as the same?"""

    def __init__(self) -> None:
        self._trial: GuidingTrial | None = None
        self._verdict = StagedVerdict()
        self.said: list[Verdict] = []

    def plan(self, iteration: Iteration, *, is_free: bool) -> Sequence[ArmSamples]:
        if not is_free or iteration.next_range[1] < 8 or iteration.is_next_last:
            return ()
        self._trial = GuidingTrial(SIZE[0] * SIZE[1])
        return halves(*iteration.next_range)

    def observe(self, unit: Unit, film: FilmTile, cost: float, *, is_aside: bool) -> None:
        if self._trial is not None:
            is_challenger = unit.arm == CHALLENGER
            self._trial.add(unit.film_index, film.radiance, film.square, unit.sample_count, is_challenger)
            self._trial.add_cost(cost, len(unit.pixels) * unit.sample_count, is_challenger)

    def conclude(self, iteration: Iteration) -> None:
        if self._trial is not None and iteration.image.weights is not None:
            self.said.append(self._verdict.take(self._trial.efficiency(iteration.image.weights)))
        self._trial = None


def test_a_learnable_and_a_question_are_a_class_and_a_line_each(monkeypatch: pytest.MonkeyPatch) -> None:
    """In a guided render, which goes on as if nobody had asked: what is compared is the same."""
    settings: dict[str, Any] = {
        "scene": lambda: pit_scene(SIZE), "samples": 48, "guiding_trial": False, "deterministic": True,
    }  # fmt: skip
    reach, sameness = Reach(), Sameness()

    def with_both(*arguments: Any, **named: Any) -> Any:
        learner = make_learner(*arguments, **named)
        assert learner is not None
        learner.learnables.append(reach)
        learner.agenda.questions.append(sameness)
        return learner

    alone = render("VMM", 1, **settings)
    monkeypatch.setattr(render_loop, "make_learner", with_both)
    result = render("VMM", 1, **settings)
    assert 0.0 < reach.reach < 100.0
    # The last iteration's records are of no use, unless somebody asks for them.
    assert (alone.guidance.record_threshold, result.guidance.record_threshold) == (0, 1 << 32)
    assert len(sameness.said) >= 2 and sameness.said[0] is Verdict.GO_ON
    assert result.report.sample_count == 48
    np.testing.assert_allclose(
        result.passes["Combined"].mean(), alone.passes["Combined"].mean(), rtol=0.05
    )


@pytest.mark.parametrize(
    ("asked", "learnables", "questions"),
    [
        ({"guiding_method": "OFF"}, None, None),
        ({"guiding_method": "OFF", "roulette": "LEARNED"}, ["LearnedRoulette"], []),
        ({"guiding_method": "OFF", "radiance_cache": "FAST"}, ["LearnedCache"], ["CacheQuestion"]),
        (
            {"guiding_method": "VMM"}, ["LearnedRegions", "LearnedPredictors"],
            ["GuidingQuestion", "MethodQuestion", "MediaQuestion"],
        ),
        (
            {"guiding_method": "AUTO", "samples": 64}, ["LearnedRegions", "LearnedRoulette", "LearnedPredictors"],
            ["GuidingQuestion", "MethodQuestion", "NetworkQuestion", "MediaQuestion", "RouletteQuestion"],
        ),
    ],
)  # fmt: skip
def test_renders_learn_and_ask_what_their_settings_say(
    asked: dict[str, Any], learnables: list[str] | None, questions: list[str] | None
) -> None:
    learner = make_learner(RenderSettings(**asked), 1, 100)
    if learner is None:
        assert learnables is questions is None
        return
    assert [type(one).__name__ for one in learner.learnables] == learnables
    assert [type(one).__name__ for one in learner.agenda.questions] == questions
    learner.close()


def test_an_iteration_is_read_by_all_and_written_by_nobody() -> None:
    fields = Iteration.__dataclass_fields__
    made = object.__new__(Iteration)
    for name in fields:
        with pytest.raises(AttributeError):
            setattr(made, name, None)
