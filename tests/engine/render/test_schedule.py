# SPDX-License-Identifier: GPL-3.0-or-later
"""What is rendered when, without rays: every sample once, tiles in the order of their samples, iterations apart."""

from __future__ import annotations

import random
from collections.abc import Callable

import pytest

from engine.guiding.policy.trial import ArmSamples, compared_arms
from engine.render.schedule import Begin, Iterations, PacedSchedule, PlainSchedule, Schedule, Steps, Task
from engine.render.strata import StrataSchedule
from engine.settings import RenderSettings
from engine.state.unit import ALL_STRATA, CHALLENGER, CURRENT, PLAIN

TILES = 7


def run(schedule: Schedule, workers: int, learn: Callable[[], Schedule | None] | None = None) -> list[Task]:
    """Tasks in the order in which they ended, done by so many at a time that end in any order.

    `learn` is called when the schedule waits; it returns the schedule to go on with, None: that was all.
    """
    order, in_work, done = random.Random(workers), [], []
    current: Schedule | None = schedule
    while True:
        while current is not None and current.has_task and len(in_work) < workers:
            in_work.append(current.take())
        if not in_work:
            return done
        task = in_work.pop(order.randrange(len(in_work)))
        done.append(task)
        assert current is not None
        if current.finish(task):
            assert not in_work and not current.has_task, "learning waits for all"
            assert learn is not None
            current = learn()


def check_samples(done: list[Task], samples: int) -> None:
    """Every tile has every sample once, in order."""
    for tile in range(TILES):
        arms = [task.arm_samples for task in done if task.tile == tile]
        assert [s for first, count, _ in arms for s in range(first, first + count)] == list(range(samples))


@pytest.mark.parametrize("workers", [1, 2, 5])
@pytest.mark.parametrize("samples", [1, 5, 21, 200])
def test_unguided_tasks_grow_and_cover_all_samples(samples: int, workers: int) -> None:
    done = run(PlainSchedule(TILES, samples), workers)
    check_samples(done, samples)
    counts = [task.arm_samples.sample_count for task in done if task.tile == 3]
    if samples == 200:
        assert counts[:12] == [1] + [4] * 10 + [5] and counts[-3:] == [18, 20, 18] and len(counts) == 25
    assert [task.is_first for task in done if task.tile == 3] == [True] + [False] * (len(counts) - 1)
    assert {task.arm_samples.arm for task in done} == {CURRENT}


def test_only_the_last_tiles_end_in_small_tasks() -> None:
    schedule, counts = PlainSchedule(50, 700), [[] for _ in range(50)]
    while schedule.has_task:
        task = schedule.take()
        counts[task.tile].append(task.arm_samples.sample_count)
        schedule.finish(task)
    assert {tuple(of_tile[-5:]) for of_tile in counts[:18]} == {(51, 57, 64, 64, 54)}
    assert {tuple(of_tile[-5:]) for of_tile in counts[18:]} == {(64, 14, 14, 14, 12)}
    assert task.tile == 49


@pytest.mark.parametrize("kind", ["unguided", "paced", "steps", "iterations", "compared", "tried"])
def test_whenever_a_render_is_cancelled_its_tiles_have_nearly_as_many_samples(kind: str) -> None:
    """But for one or two tasks of an eighth of the samples, or of a few, while one is in work."""
    fewest = 4 if kind in ("unguided", "steps") else 2
    samples, done = 300, dict.fromkeys(range(TILES), 0)
    steps = Steps(samples, lambda begin: begin + 100)
    iterations = Iterations(samples)
    schedule: Schedule = {
        "unguided": PlainSchedule(TILES, samples), "paced": PacedSchedule(TILES, samples, lambda wanted, first: wanted),
        "steps": steps,
    }.get(kind, iterations)  # fmt: skip
    steps.begin(TILES)
    iterations.begin([ArmSamples(0, 1, CURRENT)], TILES)
    in_work: list[Task] = []
    while schedule.has_task or in_work:
        while schedule.has_task and len(in_work) < 2:
            in_work.append(schedule.take())
        task = in_work.pop(0)
        done[task.tile] += task.arm_samples.sample_count
        assert max(done.values()) - min(done.values()) <= 2 * max(fewest, min(done.values()) // 8 + 1)
        if schedule.finish(task):
            if kind == "steps" and not steps.is_last:
                steps.begin(TILES)
            following = iterations.plan(0.0) if schedule is iterations else None
            if following is not None:
                is_compared = kind in ("compared", "tried") and following[1] > 3
                arms = compared_arms(*following) if is_compared else [ArmSamples(*following, CURRENT)]
                other_arms = [ArmSamples(*following, PLAIN)] if kind == "tried" and is_compared else []
                iterations.begin(arms, TILES, other_arms, TILES // 4)
    assert set(done.values()) == {samples}


def test_first_tasks_are_handed_out_before_any_second() -> None:
    schedule = PlainSchedule(TILES, 100)
    for _ in range(TILES):
        assert schedule.lacks_first_tasks
        schedule.finish(schedule.take())
    assert not schedule.lacks_first_tasks and schedule.has_task


@pytest.mark.parametrize("workers", [1, 3])
def test_iterations_wait_for_all_tiles_and_are_divided_as_learning_says(workers: int) -> None:
    samples, planned = 63, []
    iterations = Iterations(samples)
    iterations.begin([ArmSamples(0, 1, CURRENT)], TILES)

    def learn() -> Schedule | None:
        following = iterations.plan(0.0)
        if following is None:
            return None
        planned.append(following)
        first, count = following
        plain = count // 4
        arms = [ArmSamples(first, count - plain, CURRENT), ArmSamples(first + count - plain, plain, PLAIN)]
        iterations.begin(arms if plain else [ArmSamples(first, count, CHALLENGER)], TILES)
        return iterations

    done = run(iterations, workers, learn)
    check_samples(done, samples)
    assert planned == [(1, 3), (4, 4), (8, 8), (16, 16), (32, 16), (48, 15)]
    # No task of an iteration ends before all of the one before have.
    assert [task.step for task in done] == sorted(task.step for task in done)
    # All of an iteration are weighed by its first sample, whatever their arm.
    assert {task.weighs_as for task in done if task.step == 5} == {32}


@pytest.mark.parametrize("workers", [1, 3])
def test_tiles_from_some_on_may_be_divided_otherwise(workers: int) -> None:
    iterations, begun = Iterations(8), []
    iterations.begin([ArmSamples(0, 1, CURRENT)], TILES)

    def learn() -> Schedule | None:
        following = iterations.plan(0.0)
        if following is None:
            return None
        first, count = following
        begun.append(first)
        arms = [ArmSamples(first, count - 1, CURRENT), ArmSamples(first + count - 1, 1, PLAIN)]
        # Only in one iteration: what was said of it is not true of the next.
        other = [ArmSamples(first, count, PLAIN)] if len(begun) == 1 else []
        iterations.begin(arms, TILES, other, 2)
        return iterations

    done = run(iterations, workers, learn)
    check_samples(done, 8)
    arms = [[task.arm_samples.arm for task in done if task.tile == tile and task.step == 1] for tile in range(TILES)]
    assert arms == [[CURRENT, PLAIN]] * 2 + [[PLAIN] * 2] * (TILES - 2)
    assert all(task.weighs_as == 1 for task in done if task.step == 1)
    assert all(task.is_aside == (task.step == 1 and task.tile >= 2) for task in done)
    assert {task.arm_samples.arm for task in done if task.step == 2 and task.tile == 6} == {CURRENT, PLAIN}


@pytest.mark.parametrize("workers", [1, 4])
def test_a_render_that_gives_guiding_up_goes_on_without_waiting(workers: int) -> None:
    samples = 200
    iterations = Iterations(samples)
    iterations.begin([ArmSamples(0, 1, CURRENT)], TILES)

    def learn() -> Schedule:
        following = iterations.plan(0.0)
        assert following is not None
        if following[0] >= 15:
            return PlainSchedule(TILES, samples, Begin(following[0], 2))
        iterations.begin([ArmSamples(*following, CURRENT)], TILES)
        return iterations

    done = run(iterations, workers, learn)
    check_samples(done, samples)
    counts = [task.arm_samples.sample_count for task in done if task.tile == 0]
    assert counts[:12] == [1, 2, 1, 2, 2, 2, 2, 2, 2, 2, 4, 4] and sum(counts) == samples
    assert not any(task.is_first for task in done if task.arm_samples.first_sample)


@pytest.mark.parametrize("workers", [1, 4])
def test_steps_wait_for_all_tiles_and_may_lose_some(workers: int) -> None:
    """Tasks of the first step, up to the first look, are an unguided render's; later steps are one task, or two."""
    steps = Steps(120, lambda samples: max(80, samples + 16))
    steps.begin(TILES)
    ends, tile_counts = [], []

    def look() -> Schedule | None:
        ends.append(steps.next_sample)
        tile_counts.append(TILES - len(ends))
        if steps.is_last:
            return None
        steps.begin(tile_counts[-1])
        return steps

    done = run(steps, workers, look)
    assert ends == [80, 96, 112, 120]
    check_samples([task for task in done if task.arm_samples.first_sample < 80], 80)
    counts = [task.arm_samples.sample_count for task in done if task.tile == 0]
    assert counts[:3] == [1, 4, 4] and counts[16:] == [8, 10, 6, 12, 4, 8]
    assert [sum(task.arm_samples.first_sample == end for task in done) for end in ends[:-1]] == tile_counts[:-1]


def test_strata_follow_each_other_after_a_first_pass_over_all() -> None:
    settings = RenderSettings(samples=256, guiding_method="NPM", strata=4)
    iterations = Iterations(settings.samples, StrataSchedule(settings, 4))
    assert iterations.is_whole and iterations.stratum == ALL_STRATA
    iterations.begin([ArmSamples(0, 1, CURRENT)], TILES)

    def learn() -> Schedule | None:
        following = iterations.plan(0.0)
        if following is None:
            return None
        iterations.begin([ArmSamples(*following, CURRENT)], TILES)
        return iterations

    done = run(iterations, 2, learn)
    check_samples(done, settings.samples)
    strata = [task.stratum for task in done if task.tile == 0]
    assert strata == sorted(strata) and set(strata) == {ALL_STRATA, 0, 1, 2, 3}


def test_what_is_cleared_is_not_handed_out() -> None:
    """As when the time is up: tasks in work may end, and nothing follows but what they bring."""
    schedule = PlainSchedule(TILES, 100)
    task = schedule.take()
    schedule.clear()
    assert not schedule.has_task and not schedule.lacks_first_tasks
    schedule.finish(task)
    assert schedule.take().tile == task.tile
