# SPDX-License-Identifier: GPL-3.0-or-later
"""A guided render that has given its radiance cache up goes on as one that never had any."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from engine.guiding.policy.iterations import RecordBudget
from engine.guiding.policy.learnables.roulette import LearnedRoulette, RouletteModel
from engine.guiding.policy.questions.cache import Losses
from engine.guiding.policy.questions.roulette import RouletteQuestion
from engine.guiding.policy.recording import BehindCache, CacheRecording, UnguidedRecording
from engine.guiding.policy.request import NOTHING_ASKED
from engine.guiding.policy.rules import RULES
from engine.guiding.policy.standing import Standing
from engine.guiding.policy.way import Way
from engine.settings import RenderSettings


def context() -> Any:
    return SimpleNamespace(
        settings=RenderSettings(samples=256, guiding_method="AUTO", radiance_cache="CONVERGING"), unit_pixels=16,
        pixel_count=16, rules=RULES, request=NOTHING_ASKED, report=SimpleNamespace(record_count=0, trials=[]),
    )  # fmt: skip


def iteration(next_sample: int = 8, count: int = 8) -> Any:
    weights = np.ones(16, np.float32)
    return SimpleNamespace(
        next_sample=next_sample, next_range=(next_sample, count), image=SimpleNamespace(weights=weights), row_count=0,
        traced=SimpleNamespace(units=[]),
    )  # fmt: skip


def question(cache: Standing | None, guiding: Standing) -> RouletteQuestion:
    roulette: Any = SimpleNamespace(is_ready=True)
    return RouletteQuestion(context(), guiding, roulette, keeps_outside_trial=False, uses_clock=False, cache=cache)


def test_roulette_goes_by_what_was_learned_with_a_cache_and_without() -> None:
    cache = Standing()
    asked = question(cache, Standing())
    assert asked.way(Way(ends_by_learned=False)).ends_by_learned
    cache.is_over = True
    assert asked.way(Way(ends_by_learned=False)).ends_by_learned
    assert question(None, Standing()).way(Way(ends_by_learned=False)).ends_by_learned


def test_roulette_is_tried_once_both_guiding_and_the_cache_are_over() -> None:
    cache, guiding = Standing(), Standing(is_over=True)
    asked = question(cache, guiding)
    assert not asked.plan(iteration(), is_free=True) and not asked.is_comparing
    cache.is_over = True
    assert asked.plan(iteration(), is_free=True) and asked.is_comparing


@pytest.mark.parametrize(("next_sample", "learns"), [(8, True), (RULES.learned_samples + 1, False)])
def test_only_early_samples_teach_roulette_while_the_cache_lasts(
    next_sample: int, learns: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    taught = []
    cache = Standing()
    known: Any = context()
    known.report.field_seconds = 0.0
    roulette = LearnedRoulette(known, cache=cache)
    monkeypatch.setattr(RouletteModel, "learn", lambda *arguments: taught.append(1))
    found = iteration(next_sample)
    found.row_count, found.records, found.sums, found.costs = 1, None, None, None
    roulette.learn(found)
    assert bool(taught) == learns
    cache.is_over = True
    taught.clear()
    roulette.learn(found)
    assert taught


def test_what_is_recorded_behind_a_lost_cache_is_for_roulette() -> None:
    cache = Standing()
    known = context()
    cached = CacheRecording(known, RecordBudget(16, 16), cache)
    roulette: Any = SimpleNamespace(is_ready=True)
    behind = UnguidedRecording(known, 16, None, roulette, after_guiding=True)
    recording = BehindCache(known, cached, behind, cache)
    recording.budget.paths_per_sample = 12
    way = Way(ends_by_learned=True)
    agenda: Any = SimpleNamespace(challenger=None, way=way)
    assert recording.next(iteration(), agenda).record_threshold > 0 and not recording.is_over
    cache.is_over = True
    comparing: Any = SimpleNamespace(challenger=way, way=way)
    recording.next(iteration(48), comparing)
    assert not recording.is_over and recording.budget is behind.budget and behind.budget.paths_per_sample == 12
    assert recording.next(iteration(64), agenda).record_threshold == 0 and recording.is_over


@pytest.mark.parametrize(
    ("ratios", "given_up_at"),
    [
        ((2.5,), 0),
        ((1.6, 1.5), 1),
        ((1.1, 1.1, 1.1), 2),
        ((1.04, 1.04, 1.04, 1.04), 3),
        ((1.3, 0.7, 1.3, 1.1), None),
        ((1.3, 1.3, 0.5, 1.1, 1.1), None),
    ],
)
def test_the_cache_is_given_up_by_looks_that_agree(ratios: tuple[float, ...], given_up_at: int | None) -> None:
    losses = Losses(RULES)
    decided = [losses.decide(ratio) for ratio in ratios]
    assert (decided.index(True) if True in decided else None) == given_up_at
