# SPDX-License-Identifier: GPL-3.0-or-later
"""How coarse a view begins, and when its pictures come."""

from __future__ import annotations

from itertools import pairwise

import pytest

from engine.viewport.pacing import PACE, Pacing


def test_pictures_come_at_the_times_of_cycles_viewport_and_then_at_widening_intervals() -> None:
    elapsed, times = 0.0, []
    for count in range(20):
        elapsed = PACE.due(count, elapsed)
        times.append(elapsed)
    assert times[:5] == [0.1, 0.25, 0.5, 1.0, 2.0]
    intervals = [later - earlier for earlier, later in pairwise(times[4:])]
    assert all(longer >= shorter for shorter, longer in pairwise(intervals))
    assert intervals[0] > 1.0 and intervals[-1] == pytest.approx(8.0)


def test_a_slow_picture_pushes_later_ones_away() -> None:
    assert PACE.due(5, 100.0) > 101.0


def test_a_view_that_nothing_is_known_of_begins_with_an_eighth() -> None:
    assert Pacing().dividers(960, 540) == [8, 4, 2, 1]


@pytest.mark.parametrize(
    "rate, expected",
    [(1e8, 1), (1e6, 4), (1e5, 16), (1e3, 32)],
)
def test_the_first_picture_is_as_fine_as_its_time_allows(rate: float, expected: int) -> None:
    """518,400 pixels, 40 ms and some tolerance, 2 ms of which are not for tracing."""
    pacing = Pacing()
    for _ in range(30):
        pacing.note(1000, 1000 / rate, 1000 / rate + 0.002)
    assert pacing.dividers(960, 540)[0] == expected


def test_what_is_not_tracing_takes_from_the_budget() -> None:
    quick, slow = Pacing(), Pacing()
    quick.note(1000, 0.001, 0.002)
    slow.note(1000, 0.001, 0.035)
    assert slow.dividers(960, 540)[0] > quick.dividers(960, 540)[0]


@pytest.mark.parametrize("size", [(1, 1), (3, 2), (5, 5), (7, 900)])
def test_small_views_are_never_coarser_than_a_few_pixels(size: tuple[int, int]) -> None:
    dividers = Pacing().dividers(*size)
    assert dividers[-1] == 1
    assert dividers[0] <= max(max(size) // 4, 1)


def test_a_picture_without_paths_teaches_nothing() -> None:
    pacing = Pacing()
    pacing.note(0, 1.0, 2.0)
    assert pacing.dividers(960, 540)[0] == 8
