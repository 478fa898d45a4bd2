# SPDX-License-Identifier: GPL-3.0-or-later
"""What guiding is charged for learning, and for the paths that record."""

from __future__ import annotations

import math
import time
from types import SimpleNamespace
from typing import Any

import pytest

from engine.guiding.policy.iteration import Iteration
from engine.guiding.policy.iterations import RecordBudget
from engine.guiding.policy.learnables.cache import LearnedCache
from engine.guiding.policy.learnables.learnable import Learnable
from engine.guiding.policy.learnables.regions import LearnedRegions
from engine.guiding.policy.learnables.roulette import LearnedRoulette
from engine.guiding.policy.questions.guiding import learning_overhead
from engine.guiding.policy.questions.question import Question
from engine.guiding.policy.recording import GuidedRecording, threshold_beside_cache
from engine.guiding.policy.rules import RULES
from engine.guiding.policy.sets import make_learner
from engine.guiding.policy.standing import Standing
from engine.render import render_loop
from engine.settings import RenderSettings
from tests.helpers.seeded_renders import render
from tests.helpers.small_scenes import pit_scene

SIZE = (16, 16)
SLOW = 0.05


class Slow(Learnable):
    """Takes its time, for guided paths or not."""

    def __init__(self, *, serves_guiding: bool) -> None:
        self.serves_guiding = serves_guiding

    def learn(self, iteration: Iteration) -> None:
        until = time.thread_time() + SLOW
        while time.thread_time() < until:
            pass


class Listener(Question):
    """Takes down what learning took."""

    def __init__(self) -> None:
        self.seconds: list[float] = []

    def conclude(self, iteration: Iteration) -> None:
        self.seconds.append(iteration.learning_seconds)


@pytest.mark.parametrize("serves_guiding", [True, False])
def test_guiding_pays_for_what_serves_it(serves_guiding: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    listener = Listener()

    def with_both(*arguments: Any, **named: Any) -> Any:
        learner = make_learner(*arguments, **named)
        assert learner is not None
        # Nothing else learns, so that only this one can be charged.
        learner.learnables[:] = [Slow(serves_guiding=serves_guiding)]
        learner.agenda.questions.append(listener)
        return learner

    monkeypatch.setattr(render_loop, "make_learner", with_both)
    render("VMM", 1, scene=lambda: pit_scene(SIZE), samples=16, guiding_trial=False, deterministic=True)
    assert len(listener.seconds) >= 3
    charged = max(listener.seconds[1:])
    assert charged >= SLOW if serves_guiding else charged == 0.0


def test_neither_cells_nor_roulette_are_charged_to_guiding() -> None:
    """Paths that are not guided go by them too."""
    assert not LearnedCache.serves_guiding and not LearnedRoulette.serves_guiding and LearnedRegions.serves_guiding


@pytest.mark.parametrize(
    ("sample_count", "samples_left", "share"),
    [(4, math.inf, 0.25), (4, 200.0, 0.25), (4, 8.0, 0.5), (4, 2.0, 1.0), (16, math.inf, 1.0)],
)
def test_short_iterations_say_what_learning_costs_in_long_ones(
    sample_count: int, samples_left: float, share: float
) -> None:
    """Guiding was given up at the eighth sample of small pictures for what learning cost beside four samples."""
    iteration: Any = type("", (), {})()
    iteration.learning_seconds, iteration.seconds = 1.0, 1.0
    iteration.sample_count, iteration.samples_left = sample_count, samples_left
    assert learning_overhead(iteration, RULES) == pytest.approx(share)


def test_few_paths_record_where_others_end_in_cells() -> None:
    everything, early = 1 << 32, RULES.cache_early_samples
    assert threshold_beside_cache(everything, early - 1, 0.25) == everything
    assert threshold_beside_cache(everything, early, 0.25) == 1 << 30
    assert threshold_beside_cache(1 << 20, early, 0.25) == 1 << 20


def recorded_share(
    cache: Standing | None, *, outlives: bool = False, source: Any = None, is_last: bool = False
) -> float:
    """Of the paths of an iteration of 8 samples, behind 16 of 64, in a picture of 16 pixels."""
    facts: Any = SimpleNamespace(
        settings=RenderSettings(samples=64, guiding_method="VMM"), unit_pixels=16, rules=RULES,
        request=SimpleNamespace(is_for_later=outlives), light_clusters=None,
    )
    guiding: Any = SimpleNamespace(is_doubtful=False)
    recording = GuidedRecording(facts, RecordBudget(16, 16), guiding, 1, source, cache)
    iteration: Any = SimpleNamespace(
        is_early=False, next_sample=16, next_range=(16, 8), samples_left=48.0, is_next_last=is_last
    )
    agenda: Any = SimpleNamespace(guided_share=1.0, pixel_share=1.0)
    return float(recording.next(iteration, agenda).record_threshold / 2**32)


@pytest.mark.parametrize("outlives", [False, True])
def test_what_outlives_a_render_learns_from_all_paths(outlives: bool) -> None:
    """A field of a preview had half of its regions, and renders from it a quarter more error."""
    share = recorded_share(Standing(), outlives=outlives)
    assert share == pytest.approx(1.0 if outlives else RULES.cache_recorded_share)


def test_no_path_of_the_last_iteration_records_but_for_a_network_or_cells() -> None:
    assert recorded_share(None) == 1.0
    assert recorded_share(None, is_last=True) == 0.0
    assert recorded_share(Standing(is_over=True), is_last=True) == 0.0
    assert recorded_share(Standing(), is_last=True) > 0.0
    assert recorded_share(None, source=SimpleNamespace(is_over=False), is_last=True) > 0.0


def test_fewer_paths_record_where_only_cells_learn() -> None:
    assert RULES.cache_measured_share < RULES.cache_recorded_share
