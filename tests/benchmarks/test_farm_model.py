# SPDX-License-Identifier: GPL-3.0-or-later
"""The simulated cluster: what is free scales, and what all results have to pass sets the least time."""

from __future__ import annotations

from dataclasses import replace

import pytest

from benchmarks.farm_model import Costs, Frame, simulate

FREE = Costs(1e-5, 0.0, 0.0, 0.0, 0.0, 0.0, 32.0, 132.0, 0.0)
#: 1024 tiles.
FRAME = Frame(1024, 1024, 256, False)
FAST_LINK = 1e15


def test_a_coordinator_that_costs_nothing_scales() -> None:
    alone = simulate(FRAME, 1, 1, FAST_LINK, FREE)
    assert alone == pytest.approx(1024**2 * 256 * 1e-5, rel=0.2)
    assert alone / simulate(FRAME, 16, 1, FAST_LINK, FREE) > 13.0


@pytest.mark.parametrize("is_guided", [False, True])
def test_nobody_is_faster_than_the_coordinator(is_guided: bool) -> None:
    frame = replace(FRAME, is_guided=is_guided)
    tasks = sum(len(lengths) for lengths in frame.rounds)
    costs = replace(FREE, pixel_seconds=1e-6)
    least = tasks * 1024**2 * 1e-6
    assert least <= simulate(frame, 64, 16, FAST_LINK, costs) < 1.5 * least + 256 * 1024**2 * 1e-5 / 512


def test_the_link_and_learning_take_their_time() -> None:
    frame = replace(FRAME, is_guided=True)
    rounds = len(frame.rounds)
    assert simulate(frame, 64, 16, 1e8, FREE) >= rounds * frame.round_bytes(FREE) / 1e8
    slower = simulate(frame, 64, 16, FAST_LINK, replace(FREE, learning_seconds=1.0))
    assert slower == pytest.approx(simulate(frame, 64, 16, FAST_LINK, FREE) + rounds)


def test_more_threads_than_tiles_are_of_no_use() -> None:
    """Paths are so dear that any number of ranges pays."""
    frame, dear = Frame(64, 64, 1, False), replace(FREE, path_seconds=1.0)
    assert simulate(frame, 1, 16, FAST_LINK, dear) == pytest.approx(simulate(frame, 1, 4, FAST_LINK, dear))


def test_more_workers_than_pay_make_no_render_slower() -> None:
    costs = replace(FREE, path_seconds=1e-6, task_seconds=1.5e-3, pixel_seconds=5e-8)
    seconds = [simulate(FRAME, count, 16, FAST_LINK, costs) for count in (32, 1000)]
    assert seconds[1] < 1.1 * seconds[0]
