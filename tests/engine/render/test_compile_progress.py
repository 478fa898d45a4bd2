# SPDX-License-Identifier: GPL-3.0-or-later
"""How far compiling is, in numbers that users can plan by."""

from __future__ import annotations

from pathlib import Path

import pytest

from engine.render.compile_progress import CompileClock, CompileProgress, FirstCalls, Work, report_to, reported
from engine.runtime.kernel_cache import origins

STEPS = [{"shaders": Work(1, 20.0), "tracing": Work(25, 25.0)}, {"guiding": Work(22, 22.0)}]


def test_it_reads_as_a_sentence() -> None:
    assert CompileProgress(12, 48, 37.2).sentence == "Compiling kernels (once): 12 of 48 kernels, 40 s left"
    assert CompileProgress(47, 48, 0.0).sentence == "Compiling kernels (once): 47 of 48 kernels, 5 s left"
    assert CompileProgress(12, 48, 37.2).fraction == 0.25


def test_a_machine_as_expected_takes_as_long_as_expected() -> None:
    clock = CompileClock(STEPS, processors=2)
    start = clock.progress(0, {}, 0.0)
    assert (start.done, start.total, start.remaining) == (0, 48, pytest.approx(47.0))
    half = clock.progress(0, {"tracing": 10}, 10.0)
    assert half.done == 10 and half.remaining == pytest.approx(37.0)
    second = clock.progress(1, {"guiding": 11}, 11.0)
    assert second.done == 26 + 11 and second.remaining == pytest.approx(11.0)
    end = clock.progress(1, {"guiding": 22}, 22.0)
    assert end.done == end.total and end.remaining == 0.0


def test_a_slow_machine_is_noticed() -> None:
    clock = CompileClock(STEPS, processors=2)
    estimates = [clock.progress(0, {"tracing": k, "shaders": int(k > 20)}, 4.0 * k).remaining for k in (5, 10, 20, 24)]
    truth = [4.0 * (25 - k) + 4.0 * 22.0 for k in (5, 10, 20, 24)]
    errors = [abs(estimate / true - 1.0) for estimate, true in zip(estimates, truth, strict=True)]
    assert max(errors) < 0.65 and errors == sorted(errors, reverse=True) and errors[-1] < 0.25
    # One kernel alone: nothing is known before it is done, and it is never said to be over before.
    alone = CompileClock([{"shaders": Work(1, 20.0)}], processors=2)
    assert alone.progress(0, {}, 300.0).remaining > 0.0


def test_one_processor_does_one_part_after_the_other() -> None:
    assert CompileClock(STEPS, processors=1).progress(0, {}, 0.0).remaining == pytest.approx(2 * 25.0 + 22.0)


def test_more_kernels_than_expected_are_no_more_than_all() -> None:
    progress = CompileClock(STEPS, processors=2).progress(0, {"tracing": 99}, 30.0)
    assert progress.done == 25 and progress.fraction <= 1.0


def test_first_calls_are_told_from_other_work() -> None:
    watch = FirstCalls()
    assert watch.message("Preparing kernels") == "Preparing kernels"
    origins["compiled"] += 2
    try:
        assert watch.message("Preparing kernels").endswith("for what is new in this scene: 2 so far")
        assert FirstCalls().message("Building") == "Building"
    finally:
        origins["compiled"] -= 2


def test_kernels_are_counted_across_processes_by_a_file(tmp_path: Path) -> None:
    file = tmp_path / "part.count"
    assert reported(file) == 0
    for _ in range(3):
        report_to(file)
    assert reported(file) == 3
