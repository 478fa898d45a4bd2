# SPDX-License-Identifier: GPL-3.0-or-later
"""A render that the clock ends is even: all pixels have the same number of samples but for one short pass."""

from __future__ import annotations

from collections import Counter

import pytest

from engine.render.schedule import Iterations, PacedSchedule
from engine.render.session import Session
from engine.render.time_left import SHORTEST_PASS, TimeLeft
from engine.settings import RenderSettings
from tests.helpers.small_scenes import pit_scene

#: More samples than anybody has time for.
ENDLESS = 1 << 20


@pytest.mark.parametrize(
    "settings",
    [
        {"guiding_method": "OFF"},
        {"guiding_method": "AUTO"},
        {"guiding_method": "VMM", "guiding_trial": False},
        {"guiding_method": "OFF", "radiance_cache": "CONVERGING"},
        {"guiding_method": "OFF", "use_adaptive_sampling": True, "adaptive_threshold": 1e-6},
    ],
    ids=["unguided", "auto", "guided", "cached", "noise-threshold"],
)
def test_pixels_have_the_same_number_of_samples(settings):
    session = Session(RenderSettings(samples=ENDLESS, time_limit=1.5, threads=2, max_bounces=8, **settings))
    session.load(pit_scene((160, 96)))
    spreads = []
    # A machine that does something else for a moment cuts a longer pass off, but not every time.
    while not spreads or (spreads[-1] > SHORTEST_PASS and len(spreads) < 4):
        result = session.render(passes=("Combined", "Sample Count"))
        assert result.report.ended_by == "TIME_LIMIT"
        counts = result.passes["Sample Count"]
        assert counts.min() > SHORTEST_PASS
        spreads.append(counts.max() - counts.min())
    session.close()
    assert min(spreads) <= SHORTEST_PASS


def passes(monkeypatch, limit, seconds_per_sample, wanted=64, delays=None):
    """Lengths of the passes of a render in which a sample takes so long, and when it ends."""
    left, elapsed, done, lengths = TimeLeft(limit), 0.0, 0, []
    monkeypatch.setattr(TimeLeft, "elapsed", property(lambda _: elapsed))
    while elapsed < limit:
        lengths.append(left.fit(1 if not done else wanted, done))
        done += lengths[-1]
        elapsed += lengths[-1] * seconds_per_sample * (1.0 if delays is None else delays(len(lengths)))
    return lengths, elapsed


def test_passes_get_shorter_towards_the_limit(monkeypatch):
    lengths, end = passes(monkeypatch, 10.0, 0.05)
    assert lengths[:3] == [1, 64, 64]
    assert lengths[2:] == sorted(lengths[2:], reverse=True)
    assert lengths[-1] == SHORTEST_PASS
    assert 10.0 <= end <= 10.0 + SHORTEST_PASS * 0.05


def test_a_machine_that_gets_slower_by_half_cuts_no_long_pass_off(monkeypatch):
    lengths, _ = passes(monkeypatch, 10.0, 0.05, delays=lambda count: 1.0 if count % 2 else 1.5)
    assert lengths[-1] == SHORTEST_PASS


def test_the_first_image_is_whole_and_without_a_limit_nothing_is_shortened(monkeypatch):
    monkeypatch.setattr(TimeLeft, "elapsed", 1e6)
    assert TimeLeft(1.0).fit(4, 0) == 4
    free = TimeLeft(0.0)
    assert [free.fit(16, first) for first in (0, 16, 32)] == [16, 16, 16]
    assert not free.is_limited


@pytest.mark.parametrize("tile_count", [1, 3, 40])
def test_tasks_of_a_pass_are_alike_and_tiles_are_never_a_pass_apart(tile_count):
    asked = []

    def pace(wanted, first):
        asked.append((wanted, first))
        return min(wanted, 5)

    schedule, samples, out = PacedSchedule(tile_count, 23, pace), Counter(), []
    while schedule.has_task or out:
        if schedule.has_task and len(out) < 2:
            out.append(schedule.take())
            continue
        task = out.pop(0)
        first, count, _ = task.arm_samples
        assert samples[task.tile] == first
        assert task.is_first == (first == 0)
        samples[task.tile] += count
        assert not schedule.finish(task)
        behind = min(samples[tile] for tile in range(tile_count))
        # One in work.
        assert max(samples.values()) - behind <= 2 * 5
    assert samples == Counter({tile: 23 for tile in range(tile_count)})
    assert asked == [(1, 0), *((4, first) for first in range(1, 21, 4)), (2, 21)]


def test_a_pass_that_may_be_cut_off_begins_when_all_tiles_are_there():
    """However slow one tile is, when the clock ends the render tiles differ by one such pass at most."""
    schedule = PacedSchedule(8, 64, lambda wanted, first: min(wanted, 16 if first < 37 else 2))
    samples, out, slow = Counter(), [], 3
    while schedule.has_task or out:
        if schedule.has_task and len(out) < 2:
            out.append(schedule.take())
            continue
        # The slow tile is finished only when nothing else is to be done.
        task = min(out, key=lambda one: one.tile == slow)
        out.remove(task)
        first, count, _ = task.arm_samples
        samples[task.tile] += count
        schedule.finish(task)
        behind = min(samples[tile] for tile in range(8))
        if behind >= 37:
            assert max(samples.values()) - behind <= SHORTEST_PASS
    assert samples == Counter({tile: 64 for tile in range(8)})


def test_an_iteration_that_does_not_fit_is_continued_by_the_next():
    lengths = iter([3, 4, 2, 2, 4])
    iterations = Iterations(32, pace=lambda wanted, first: min(next(lengths), wanted) if first else wanted)
    iterations.begin([], 0)
    planned = [(0, 1)]
    for _ in range(5):
        planned.append(iterations.plan(0.0))
        # Asked again, it says the same.
        assert iterations.plan(0.0) == planned[-1]
        iterations.begin([], 0)
    assert planned == [(0, 1), (1, 3), (4, 4), (8, 2), (10, 2), (12, 4)]
