# SPDX-License-Identifier: GPL-3.0-or-later
"""Efficiency over the better Cycles: the ratio itself, and how often its interval holds what it should."""

from __future__ import annotations

import math

import numpy as np
import pytest

from benchmarks.equal_time import Ratio, cost, over_better_cycles, over_better_cycles_table, ratio
from benchmarks.rendering import Render, RenderRecord

TRUTH = np.full((24, 32, 3), 2.0, np.float32)


def pictures(rng: np.random.Generator, deviation: float, seeds: int, spread: float = 0.0) -> list[np.ndarray]:
    """Renders whose noise differs from seed to seed by a log-normal factor, as where a trial ends differently."""
    scales = deviation * np.exp(spread * rng.standard_normal(seeds))
    return [(TRUTH + rng.normal(0.0, scale, TRUTH.shape)).astype(np.float32) for scale in scales]


def renders(images: list[np.ndarray], rival: str, seconds: float) -> list[Render]:
    return [
        Render(image, RenderRecord("hall", "", rival, seed, 32, 24, 1, seconds, 1, render_seconds=seconds))
        for seed, image in enumerate(images)
    ]


def test_an_efficiency_is_error_and_seconds_against_the_better_cycles() -> None:
    rng = np.random.default_rng(1)
    found = over_better_cycles(
        {
            "cycles": renders(pictures(rng, 0.4, 8), "cycles", 10.0),
            "cycles-guided": renders(pictures(rng, 0.2, 8), "cycles-guided", 10.0),
            "OFF": renders(pictures(rng, 0.2, 8), "OFF", 5.0),
            "AUTO": renders(pictures(rng, 0.1, 8), "AUTO", 10.0),
        },
        TRUTH,
    )
    assert list(found) == ["OFF", "AUTO"]
    assert found["OFF"].value == pytest.approx(2.0, rel=0.15)
    assert found["AUTO"].value == pytest.approx(4.0, rel=0.15)
    assert found["AUTO"].low < found["AUTO"].value < found["AUTO"].high


def test_intervals_hold_the_truth_as_often_as_they_say() -> None:
    # 300 pairs of 4 seeds. Of 300 intervals of 95% fewer than 270 hold the truth once in 10,000 (binomial).
    rng = np.random.default_rng(2)
    held = 0
    for _ in range(300):
        ours, theirs = (cost(pictures(rng, deviation, 4, 0.1), [1.0] * 4, TRUTH) for deviation in (0.1, 0.2))
        found = ratio(theirs, ours)
        held += found.low < 4.0 < found.high
    assert held >= 270


def test_an_interval_that_ignores_how_seeds_differ_would_be_too_narrow() -> None:
    rng = np.random.default_rng(3)
    alike = cost(pictures(rng, 0.2, 4), [1.0] * 4, TRUTH)
    unlike = cost(pictures(rng, 0.2, 4, 0.5), [1.0] * 4, TRUTH)
    assert unlike.relative_error > 3.0 * alike.relative_error


def test_three_seeds_have_a_ratio_without_an_interval() -> None:
    rng = np.random.default_rng(4)
    found = ratio(*(cost(pictures(rng, 0.2, 3), [1.0] * 3, TRUTH) for _ in range(2)))
    assert found.value == pytest.approx(1.0, rel=0.2)
    assert math.isnan(found.low) and str(found).count("to") == 0


def test_a_mean_needs_every_scene() -> None:
    known = Ratio(2.0, math.nan, math.nan)
    found = {("a", "1s"): {"OFF": known, "AUTO": known}, ("b", "1s"): {"OFF": Ratio(8.0, 7.0, 9.0)}}
    lines = over_better_cycles_table(found).splitlines()
    assert [cell.strip() for cell in lines[-1].split("|")[1:-1]] == ["geometric mean", "4", "-"]
    assert "8 (7 to 9)" in lines[3]
