# SPDX-License-Identifier: GPL-3.0-or-later
"""How many paths of an iteration are recorded, and which iterations are learned from."""

from __future__ import annotations

import pytest

from engine.guiding.policy.iterations import LearningRests, RecordBudget
from engine.guiding.policy.rules import RULES
from engine.guiding.records.vertices import RECORD_ROWS


@pytest.mark.parametrize("pixels", [256, 1024, 4096, 8192, 36_864, 921_600])
@pytest.mark.parametrize("per_path", [0.5, 4.0, 20.0])
@pytest.mark.parametrize("samples", [1.0, 16.0, 32.0])
def test_records_fit(pixels: int, per_path: float, samples: float) -> None:
    """Those of a unit, with as much again to spare, and no more of the image than learning has time for."""
    unit = min(pixels, 1024)
    budget = RecordBudget(pixels, unit)
    budget.count(round(1000 * per_path), 1000.0)
    share = budget.threshold(samples) / 2**32
    assert share * unit * samples * per_path <= 0.5 * RECORD_ROWS * 1.001
    assert share * pixels * samples * per_path <= RULES.records_per_iteration * 1.001
    # And as many as these allow.
    of_unit = share * unit * samples * per_path / (0.5 * RECORD_ROWS)
    of_image = share * pixels * samples * per_path / RULES.records_per_iteration
    assert share == 1.0 or max(of_unit, of_image) == pytest.approx(1.0, rel=1e-3)


def test_few_paths_are_recorded_while_nobody_knows_whether_it_pays() -> None:
    """So many records, or so large a share of a large image's paths, and never more than are wanted at all."""
    shares = {4096: RULES.few_records / (4.0 * 16 * 4096), 36_864: 0.03, 1 << 20: 1 / 256, 1024: 0.5}
    for pixels, share_of_all in shares.items():
        budget = RecordBudget(pixels, 1024)
        before = budget.threshold(16.0)
        budget.is_frugal = True
        found = budget.threshold(16.0)
        assert found <= before
        assert found / 2**32 == pytest.approx(min(share_of_all, before / 2**32), rel=1e-3)


@pytest.mark.parametrize(
    ("pixels", "samples", "records"),
    [(14_400, 24, 1 << 15), (100_000, 56, 112_000), (400_000, 24, 192_000), (1 << 20, 1000, 1 << 18)],
)
def test_what_is_still_to_come_pays_for_records_before_anybody_knows(pixels: int, samples: int, records: int) -> None:
    """In large and long renders early iterations teach the guide more, as all later samples are drawn by it."""
    budget = RecordBudget(pixels, 16)
    budget.is_frugal = True
    budget.samples_to_come = samples
    assert budget.threshold(1.0) / 2**32 * 4.0 * pixels == pytest.approx(records, rel=1e-3)


def test_fewer_paths_are_recorded_where_little_is_left() -> None:
    """In proportion to the paths to come, but not below what a trial has; where nobody knows how many, all."""
    pixels = 14_400
    budget = RecordBudget(pixels, 128)
    budget.is_for_image = True

    def records(to_come: float | None) -> float:
        budget.samples_to_come = to_come
        return budget.threshold(16.0) / 2**32 * 4.0 * 16 * pixels

    assert records(1000.0) == records(None) == pytest.approx(RULES.records_per_iteration, rel=1e-3)
    assert records(32.0) == pytest.approx(RULES.records_per_path_left * 32 * pixels, rel=1e-3)
    # Of the last iteration nobody asks, so that one sample is to come at least.
    assert records(1.0) == records(0.0) == pytest.approx(RULES.few_records, rel=1e-3)
    budget.is_for_image = False
    assert records(32.0) == pytest.approx(RULES.records_per_iteration, rel=1e-3)


def test_guiding_a_quarter_of_the_pixels_needs_as_many_records() -> None:
    budget = RecordBudget(1 << 20, 1024)
    assert budget.threshold(16.0, 0.25) == pytest.approx(4 * budget.threshold(16.0), rel=1e-6)
    # But not more than a unit has room for.
    small = RecordBudget(14_400, 1024)
    assert small.threshold(16.0, 0.25) / 2**32 * 4.0 * 16 * 1024 <= 0.5 * RECORD_ROWS * 1.001


def test_learning_rests_while_few_pixels_have_few_paths() -> None:
    """An iteration of a tenth of the pixels is a tenth of one of all: five of them are half of it."""
    rests = LearningRests(1000)
    assert not any(rests.take(pixels, 16) for pixels in (1000, 500, 1000))
    assert [rests.take(100, 16) for _ in range(10)] == 2 * ([True] * 4 + [False])
    assert not rests.take(1000, 1)
