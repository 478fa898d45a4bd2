# SPDX-License-Identifier: GPL-3.0-or-later
"""A network that directions come from is tried as the mixture field is that stands in for it."""

from __future__ import annotations

import math
import time
from typing import Any

import numpy as np
import pytest

from engine.guiding.policy import sets
from engine.guiding.policy.learnables.source import LearnedSource
from engine.guiding.policy.metered import LearningTime, MeteredExecutor
from engine.guiding.policy.plain_trial import PlainTrial
from engine.guiding.policy.request import LearningRequest
from engine.guiding.policy.rules import RULES
from engine.settings import RenderSettings
from engine.state.film import allocate_tile
from engine.state.unit import PLAIN, Unit
from tests.helpers.seeded_renders import render, trial_rules
from tests.helpers.small_scenes import pit_scene
from tests.helpers.untrained_networks import Late

SAMPLES = 1 << 14
WEIGHTS = np.ones(1, np.float32)
#: So large a picture that guiding is tried on a quarter of its pixels.
PARTS: dict[str, Any] = {
    "scene": lambda: pit_scene((64, 64)), "samples": 64, "max_bounces": 12, "diffuse_bounces": 12,
    "deterministic": True, "candidate_allocation": "FIXED",
}  # fmt: skip


def go(
    trial: PlainTrial, worth: float, first: int, *, is_learning: bool = False, samples_left: float = math.inf
) -> int:
    """One iteration, in which what guides is worth so much over unguided rendering; the next one's first sample."""
    for arm in trial.plan(first, SAMPLES):
        unit, tile = Unit(np.zeros((1, 2), np.int32), np.zeros(1, np.int64), *arm), allocate_tile(1, 3)
        tile.square[:] = arm.sample_count / (1.0 if arm.arm == PLAIN else worth)
        trial.compare(unit, tile, float(arm.sample_count), is_aside=False)
    first += SAMPLES
    trial.judge(WEIGHTS, first, 0.0, samples_left, is_learning=is_learning)
    return first


def test_what_still_learns_gets_the_benefit_of_the_doubt_in_each_comparison() -> None:
    doubted, trial, first = 0.6, PlainTrial(1, tries_plain=True), 1
    assert RULES.least_efficiency[2] < doubted < RULES.least_efficiency[4]
    for _ in range(12):
        first = go(trial, doubted, first, is_learning=True)
        assert not trial.has_lost and not trial.is_settled
    # Once it has learned, as much is asked of it as of anything that has been compared so often.
    for _ in range(3):
        assert not trial.has_lost
        first = go(trial, doubted, first)
    assert trial.has_lost


def test_what_still_learns_and_is_hopeless_loses_at_once() -> None:
    trial, first = PlainTrial(1, tries_plain=True), 1
    while not trial.has_lost:
        first = go(trial, 0.4, first, is_learning=True)
    assert first == 1 + 3 * SAMPLES


def test_a_trial_goes_on_where_it_stood_when_its_successor_has_lost() -> None:
    mixture, first = PlainTrial(1, tries_plain=True), 1
    while not mixture.is_settled:
        first = go(mixture, 3.0, first)
    network = mixture.successor(first)
    assert not network.is_settled and not network.is_paying
    while not network.has_lost:
        first = go(network, 0.3, first)
    assert mixture.is_settled and mixture.is_paying and not mixture.has_lost
    assert mixture.efficiency == pytest.approx(3.0, rel=1e-3)
    # What is sure is not looked at again.
    for _ in range(20):
        first = go(mixture, 3.0, first)
    assert not mixture.has_lost


def test_a_network_that_comes_late_is_not_asked_for_more_for_that() -> None:
    """What is left is compared with what its own trial has taken, as of the mixture field before."""
    worth, begun = 0.6, 64 * SAMPLES
    assert RULES.least_efficiency[2] < worth < RULES.least_of_short
    for left, has_lost in ((10 * SAMPLES, True), (30 * SAMPLES, False)):
        network, first = PlainTrial(1, tries_plain=True).successor(begun), begun
        for _ in range(2):
            first = go(network, worth, first, samples_left=left)
        assert first == begun + 2 * SAMPLES and network.has_lost == has_lost


def trials(method: str, monkeypatch: pytest.MonkeyPatch, silence: int, **settings: Any) -> Any:
    """Report of a render whose network comes after so many iterations."""
    monkeypatch.setattr(sets, "make_source_model", lambda asked: Late(asked, 20.0, silence))
    return render(method, 0, **(PARTS | settings)).report.guiding


def test_until_there_is_a_network_the_trial_is_that_of_the_mixture_field(monkeypatch: pytest.MonkeyPatch) -> None:
    """As many records, on as many pixels, asked for as much."""
    mixture = render("VMM", 0, **PARTS).report.guiding
    network = trials("NPM", monkeypatch, 99)
    assert mixture.trials and len(network.trials) == len(mixture.trials)
    for found, expected in zip(network.trials, mixture.trials, strict=True):
        # The methods' kernels are compiled apart and round apart.
        said, asked = found.split(), expected.replace("VMM", "the mixture field").split()
        value = said.index("OFF") + 1
        assert float(said.pop(value)) == pytest.approx(float(asked.pop(value)), rel=0.1) and said == asked
    assert network.record_count == pytest.approx(mixture.record_count, rel=0.02)
    assert network.stopped_at == mixture.stopped_at


def test_a_network_is_tried_on_a_quarter_of_the_pixels_where_nothing_is_known_to_pay(
    monkeypatch: pytest.MonkeyPatch
) -> None:
    """And its stand-in goes on being tried from where it stood."""
    shares: list[tuple[str, float]] = []
    judge = PlainTrial.judge

    def noting(trial: PlainTrial, *arguments: Any, **named: Any) -> bool:
        shares.append((str(id(trial)), named["is_part"]))
        return judge(trial, *arguments, **named)

    monkeypatch.setattr(PlainTrial, "judge", noting)
    report = trials("NPM", monkeypatch, 2, samples=255)
    assert report.source_stopped_at
    # The mixture's, the network's, and again the mixture's.
    order = list(dict.fromkeys(name for name, _ in shares))
    assert len(order) == 2 and shares[0][0] == order[0]
    assert any(is_part for name, is_part in shares if name == order[1])
    said = [trial.split(" over")[0] for trial in report.trials]
    lost = max(index for index, name in enumerate(said) if name == "NPM")
    assert not report.stopped_at or report.stopped_at > report.source_stopped_at
    assert set(said[lost + 1 :]) <= {"the mixture field"}


@pytest.mark.parametrize("is_learning", [True, False])
def test_a_network_is_said_to_learn_until_it_has_been_trained_by_some_steps(
    is_learning: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    counts = iter([1, RULES.source_least_steps - 1, RULES.source_least_steps, *[RULES.source_doubtful_steps] * 99])

    class Learning(Late):
        """Trained by the most steps that are too few to guide by, by so few that one may doubt, by enough."""

        count = 0

        def learn(self, *arguments: Any) -> None:
            super().learn(*arguments)
            self.count = next(counts)

        @property
        def step_count(self) -> int:
            return self.count

        @property
        def is_learning(self) -> bool:
            return is_learning

    heard: list[bool] = []
    guided: list[bool] = []
    judge, complete = PlainTrial.judge, LearnedSource.complete

    def completing(source: LearnedSource, *arguments: Any) -> Any:
        guidance = complete(source, *arguments)
        guided.append(guidance.source is not None)
        return guidance

    def noting(trial: PlainTrial, *arguments: Any, **named: Any) -> bool:
        heard.append(named["is_learning"])
        return judge(trial, *arguments, **named)

    monkeypatch.setattr(PlainTrial, "judge", noting)
    monkeypatch.setattr(LearnedSource, "complete", completing)
    monkeypatch.setattr(sets, "make_source_model", lambda asked: Learning(asked, 1.0, 1))
    # Whatever it is worth: nothing is given up.
    render("NPM", 0, rules=trial_rules(0.0), **(PARTS | {"samples": 127}))
    if is_learning:
        # It guides from when it has been trained a little, and is new to when it has been trained by more.
        assert guided[:4] == [False, False, False, True]
        assert heard[:4] == [False, False, False, True] and not any(heard[4:]) and len(heard) > 4
    else:
        # What has learned all that there is guides at once.
        assert guided[:2] == [False, True] and not any(heard)


def test_learning_takes_the_time_of_its_processors() -> None:
    """Not that of threads that trace meanwhile, nor what it waits for."""
    executor = MeteredExecutor(2)

    def work(seconds: float) -> None:
        began = time.thread_time()
        while time.thread_time() - began < seconds:
            pass

    beside, before = LearningTime(executor, 0), LearningTime(executor, 16)
    beside.begin()
    before.begin()
    list(executor.map(work, (0.02, 0.03)))
    work(0.01)
    time.sleep(0.2)
    taken, waited = beside.end(), before.end()
    assert 0.06 <= taken < 0.2
    assert waited >= 16 * 0.2
    executor.shutdown()


def test_threads_wait_for_learning_where_all_samples_are_to_teach() -> None:
    settings = RenderSettings()
    assert LearningRequest().bridges(settings)
    assert not LearningRequest(keeps=True).bridges(settings)
    assert not LearningRequest().bridges(RenderSettings(strata=4, u_dimension="TIME"))
