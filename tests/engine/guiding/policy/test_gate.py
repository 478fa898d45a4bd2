# SPDX-License-Identifier: GPL-3.0-or-later
"""A network is trained for a short while where that can pay, and held-out records decide whether it is kept."""

from __future__ import annotations

import math

import pytest

from engine.guiding.models.predictors import Predictor, TablePredictor
from engine.guiding.models.regions import RegionModels
from engine.guiding.models.report import GuidingReport
from engine.guiding.policy import remaining_samples
from engine.guiding.policy.gate import Gate
from engine.guiding.policy.questions.method import Ladder, MethodTrial
from engine.guiding.policy.remaining_samples import RemainingSamples
from engine.guiding.policy.rules import RULES
from engine.guiding.records.vertices import allocate_vertex_records
from engine.methods import RUNGS
from engine.settings import RenderSettings

SAMPLES = 1000


class Counting(Predictor):
    """Counts how often it is begun; ready when it is told to."""

    is_asynchronous = True
    has_begun = is_ready = is_learning = False
    step_count = 0

    def __init__(self, report: GuidingReport) -> None:
        super().__init__(RenderSettings(), report, [])
        self.begun_count = self.dropped_count = self.closed_count = 0

    def begin(self, region_count: int) -> None:
        self.begun_count += 1
        self.has_begun = True

    def drop(self) -> None:
        self.is_ready = False
        self.dropped_count += 1

    def close(self) -> None:
        self.closed_count += 1


def gate_of(pixels: float = RULES.least_paths_left, *, judges_on: bool = True) -> tuple[Gate, Counting, GuidingReport]:
    report = GuidingReport()
    predictor = Counting(report)
    remaining = RemainingSamples(RenderSettings(samples=SAMPLES), int(pixels), uses_clock=False)
    return Gate(predictor, report, remaining, judges_on=judges_on), predictor, report


def test_whatever_the_mixture_promises_a_long_render_trains_a_network() -> None:
    gate, predictor, _ = gate_of()
    gate.begin(RULES.network_from - 1, 1)
    assert predictor.begun_count == 0
    gate.begin(RULES.network_from, 1)
    assert predictor.begun_count == 1 and not gate.is_open and not gate.wants_figure
    predictor.is_ready = True
    assert gate.wants_figure
    for k in range(RULES.network_looks):
        assert not gate.is_open
        gate.judge(31 + 16 * k, 1.5)
    assert gate.is_open
    gate.begin(95, 1)
    assert predictor.begun_count == 1


def test_a_short_render_trains_none() -> None:
    gate, predictor, report = gate_of(RULES.least_paths_left / SAMPLES / 2)
    gate.begin(15, 1)
    gate.judge(31, None)
    assert predictor.begun_count == 0 and report.network_stopped_at == 0


@pytest.mark.parametrize("promise", [0.5, 1.0, 0.99 * RULES.network_kept])
@pytest.mark.parametrize("first_snapshot", [116, 308])
def test_what_promises_too_little_is_tried_for_a_tenth_of_what_was_left(promise: float, first_snapshot: int) -> None:
    """From its first snapshot on, whatever the process that trains it took to come to that."""
    gate, predictor, report = gate_of()
    gate.begin(100, 1)
    for sample in range(116, SAMPLES, 16):
        predictor.is_ready = sample >= first_snapshot
        gate.judge(sample, promise if gate.wants_figure else None)
        assert not gate.is_open
        if report.network_stopped_at:
            break
    over = first_snapshot + RULES.network_trial_share * (SAMPLES - first_snapshot)
    assert over <= report.network_stopped_at < over + 16 and predictor.dropped_count == 1
    # It does not begin anew.
    gate.begin(400, 1)
    assert predictor.begun_count == 1 and not gate.wants_figure


def test_what_has_no_snapshot_yet_is_not_given_up() -> None:
    """Samples of a small picture by many threads are over before the process that trains is ready."""
    gate, predictor, report = gate_of()
    gate.begin(15, 1)
    for sample in range(31, 900, 16):
        gate.judge(sample, None)
    assert not report.network_stopped_at and predictor.dropped_count == 0
    predictor.is_ready = True
    for sample in (911, 927, 943):
        gate.judge(sample, 1.5)
    assert gate.is_open


class Clock:
    """Stands for the module `time` of what counts seconds."""

    def __init__(self) -> None:
        self.seconds = 0.0

    def perf_counter(self) -> float:
        return self.seconds


def test_a_trial_counts_seconds_and_steps_where_the_clock_may_be_asked(monkeypatch: pytest.MonkeyPatch) -> None:
    clock = Clock()
    monkeypatch.setattr(remaining_samples, "time", clock)
    report = GuidingReport()
    predictor = Counting(report)
    # 16 samples take a quarter of a second: 4000 of them take a minute.
    remaining = RemainingSamples(RenderSettings(samples=4000), 1, uses_clock=True)
    gate = Gate(predictor, report, remaining, judges_on=True)

    def go(samples: range, promise: float = 1.0) -> None:
        for sample in samples:
            clock.seconds = sample / 64.0
            gate.judge(sample, promise)

    clock.seconds = 0.25
    gate.begin(16, 1)
    assert predictor.begun_count == 1
    # It is ready after five seconds; what is left then, 57.5 s, would give it 5.75 s, but it has hardly learned.
    go(range(32, 320, 16))
    predictor.is_ready = predictor.is_learning = True
    predictor.step_count = 20
    go(range(320, 320 + 8 * 64, 16))
    assert not report.network_stopped_at
    predictor.step_count = 20 + RULES.network_trial_steps
    go(range(320 + 8 * 64, 320 + 8 * 64 + 16, 16))
    assert report.network_stopped_at == 320 + 8 * 64


@pytest.mark.parametrize("promise", [1.0, None])
def test_a_trial_is_over_after_a_quarter_of_what_was_left_however_little_was_learned(promise: float | None) -> None:
    """Or looked at: iterations may leave no records."""
    gate, predictor, report = gate_of()
    gate.begin(15, 1)
    predictor.is_ready = predictor.is_learning = True
    for sample in range(31, SAMPLES, 16):
        gate.judge(sample, promise)
        if report.network_stopped_at:
            break
    over = 31 + RULES.network_longest_share * (SAMPLES - 31)
    assert over <= report.network_stopped_at < over + 16


def test_what_has_learned_all_there_is_need_not_be_trained_by_more_steps() -> None:
    gate, predictor, report = gate_of()
    gate.begin(15, 1)
    predictor.is_ready = True
    for sample in range(31, 31 + 8 * 16, 16):
        gate.judge(sample, 1.0)
    assert 31 + 0.1 * (SAMPLES - 31) <= report.network_stopped_at <= 31 + 7 * 16


@pytest.mark.parametrize("judges_on", [True, False])
def test_what_is_kept_is_judged_on_where_nobody_else_does(judges_on: bool) -> None:
    gate, predictor, report = gate_of(judges_on=judges_on)
    gate.begin(15, 1)
    predictor.is_ready = True
    for sample in (31, 47, 63):
        gate.judge(sample, 1.2)
    assert gate.is_open and gate.wants_figure == judges_on
    # A bad figure is made up for by the others; and what it is worth to go on is less than what it is to begin.
    assert RULES.network_given_up < RULES.network_kept
    gate.judge(79, (0.5 * (RULES.network_given_up + RULES.network_kept)) ** 3 / 1.2**2)
    assert gate.is_open
    # Nothing is given up while it is on trial.
    gate.judge(95, 0.5)
    assert gate.is_open
    for sample in (111, 127, 143):
        gate.judge(sample, 0.9)
    assert gate.is_open != judges_on and (report.network_stopped_at > 0) == judges_on
    assert math.isfinite(report.network_promise)


def test_training_ends_after_a_quarter_of_the_render_and_what_was_learned_stays() -> None:
    gate, predictor, report = gate_of()
    gate.begin(15, 1)
    predictor.is_ready = True
    for sample in range(31, int(RULES.network_trained_share * SAMPLES), 16):
        gate.judge(sample, 1.2)
        assert gate.is_open == (sample >= 63) and predictor.closed_count == 0
    gate.judge(255, 1.2)
    assert predictor.closed_count == 1 and gate.is_open and predictor.dropped_count == 0
    # It is judged on all the same.
    for sample in (271, 287, 303):
        gate.judge(sample, 0.9)
    assert not gate.is_open and report.network_stopped_at == 287


def test_samples_left_go_by_the_clock_where_there_is_a_limit() -> None:
    settings = RenderSettings(samples=SAMPLES, time_limit=1e-6)
    assert RemainingSamples(settings, 10**9, uses_clock=True).samples_left(10) == 0.0
    assert not RemainingSamples(settings, 10**9, uses_clock=True).is_long(10)
    assert RemainingSamples(settings, 10**9, uses_clock=False).samples_left(10) == SAMPLES - 10


def test_caution_asks_for_so_many_times_as_long_a_render() -> None:
    enough = -(-int(RULES.least_paths_left) // (SAMPLES - 10))
    for pixels, caution, is_long in ((enough, 1.0, True), (enough, 5.0, False), (5 * enough, 5.0, True)):
        remaining = RemainingSamples(RenderSettings(samples=SAMPLES), pixels, uses_clock=False, caution=caution)
        assert remaining.is_long(10) == is_long


def test_auto_compares_a_network_that_is_kept_whatever_coarser_methods_promise() -> None:
    settings = RenderSettings(samples=SAMPLES)
    gate, network, report = gate_of(judges_on=False)
    table = TablePredictor(settings, report, [])
    predictors = {"": Predictor(settings, report, []), "TABLE": table, "NETWORK": network}
    method = MethodTrial(1, RUNGS[0])
    ladder = Ladder(settings, RUNGS, predictors)
    regions = RegionModels.of_records(allocate_vertex_records(4), 4, 0.5)
    gate.begin(15, 1)
    network.is_ready = True
    assert ladder.offers(method, 31, False, regions, gate) == []
    for sample in (31, 47, 63):
        gate.judge(sample, 1.5)
    assert ladder.offers(method, 47, False, regions, gate) == ["NEURAL_RIS", "VMM"]
    # Coarser methods come first where they promise to pay.
    assert ladder.offers(method, 47, True, regions, gate) == ["VMM_RIS", "NEURAL_RIS", "VMM"]
    # What is being tried stays among them.
    method.plan(47, 16, ["NEURAL_RIS", "VMM"])
    assert method.challenger == "NEURAL_RIS"
    assert ladder.offers(method, 63, False, regions, gate) == ["VMM_RIS", "NEURAL_RIS", "VMM"]
