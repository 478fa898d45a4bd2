# SPDX-License-Identifier: GPL-3.0-or-later
"""What is traced while learning goes on: which samples, by what, and that the picture does not tell."""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest

from engine.guiding.policy.guidance import Guidance
from engine.guiding.policy.iteration import Traced
from engine.guiding.policy.trial import ArmSamples
from engine.guiding.records.cache_records import allocate_cache_records
from engine.guiding.records.unit_records import UnitRecords
from engine.guiding.records.vertices import allocate_vertex_records
from engine.render import bridge as bridges
from engine.render import render_loop
from engine.render.batch import Statistics
from engine.render.bridge import Bridge, bridge_samples
from engine.render.bridged import BridgedIterations
from engine.render.film import Film
from engine.render.render_loop import RenderLoop
from engine.render.request import RenderRequest
from engine.render.schedule import Iterations, Task
from engine.render.tiles import TILE_SIZE
from engine.scene.description import Frame
from engine.settings import RenderSettings
from engine.state.columns import rows_of
from engine.state.film import FilmTile, allocate_tile
from engine.state.unit import BRIDGE, CHALLENGER, CURRENT, PLAIN, Unit, UnitCosts
from tests.helpers.seeded_renders import render
from tests.helpers.small_scenes import corner_scene

WHOLE = [ArmSamples(16, 16, CURRENT)]


def test_half_of_a_long_iteration_bridges_where_nothing_is_compared():
    assert bridge_samples(WHOLE, [], 16) == 8
    assert bridge_samples(WHOLE, [], bridges.SHORTEST_BRIDGED - 1) == 0
    assert bridge_samples(WHOLE, [ArmSamples(16, 16, PLAIN)], 16) == 0
    assert bridge_samples([ArmSamples(16, 8, CURRENT), ArmSamples(24, 8, CHALLENGER)], [], 16) == 0
    assert bridge_samples([ArmSamples(16, 16, PLAIN)], [], 16) == 0


def _unit(tile: int) -> Unit:
    return Unit(np.zeros((3, 2), np.int32), np.arange(3 * tile, 3 * tile + 3), 16, 8, arm=BRIDGE)


def _sums(value: float, samples: int = 8) -> FilmTile:
    sums = allocate_tile(TILE_SIZE**2, 3)
    sums.radiance[:], sums.count[:] = value, samples
    return sums


def test_sums_wait_for_learning():
    put: list[tuple[int, float, float]] = []

    def take(units, sums, weight):
        put.append((int(units[0].film_index[0]), float(sums.radiance[0, 0]), weight))

    bridge = Bridge(take)
    assert bridge.is_traced
    bridge.begin(16, 8, 2, 0.5)
    tasks = [bridge.take(), bridge.take()]
    assert not bridge.has_task
    assert all(task.arm_samples == ArmSamples(16, 8, BRIDGE) for task in tasks)
    sums = _sums(1.0)
    bridge.keep([_unit(0)], sums)
    # The thread's memory is its next unit's.
    sums.radiance[:] = 7.0
    assert not bridge.finish(tasks[0]) and not bridge.is_traced
    assert not put
    bridge.let_go()
    assert put == [(0, 1.0, 0.5)]
    bridge.keep([_unit(1)], _sums(2.0))
    assert not bridge.finish(tasks[1]) and bridge.is_traced
    assert put == [(0, 1.0, 0.5), (3, 2.0, 0.5)]


def _trace(loop: RenderLoop, value: float) -> bool:
    """Finish the next task, of whose samples each sum is `value`; whether the loop waits."""
    task = loop.take()
    unit = loop.unit(task)
    sums = _sums(value, unit.sample_count)
    records = UnitRecords(rows_of(allocate_vertex_records(1, 3), 0, 0), rows_of(allocate_cache_records(1), 0, 0))
    rows = rows_of(sums, 0, len(unit.pixels))
    loop.keep(task, unit, rows, UnitCosts(), records if loop.records(unit.arm) else None)
    # The thread's memory is its next unit's.
    sums.radiance[:] = -1000.0
    return loop.finish(task)


@pytest.mark.parametrize("learning_ends_first", [True, False])
def test_the_film_waits_for_learning_and_what_follows_for_all(
    learning_ends_first: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In whatever order learning and the last task end."""
    frame = Frame(2 * TILE_SIZE, TILE_SIZE, (0, 0, 2 * TILE_SIZE, TILE_SIZE))
    settings = RenderSettings(samples=64, guiding_method="VMM", guiding_trial=False, deterministic=True)
    film = Film(frame.width, frame.height)
    loop = RenderLoop(RenderRequest(frame, settings), film, 1, lambda guidance, arm: None)
    assert loop.learner is not None
    loop.ready()
    seen: list[str] = []
    learn = loop.learner.learn

    def learn_meanwhile(traced: Traced) -> Guidance:
        assert traced.next_range == (24, 8)
        before = film.sums.radiance.copy()
        for left in (1, 0):
            if left or not learning_ends_first:
                assert loop.has_task and not _trace(loop, 100.0)
                seen.append("bridge")
        assert loop.has_task is learning_ends_first
        assert np.array_equal(film.sums.radiance, before)
        seen.append("learned")
        return learn(traced)

    while loop.has_task:
        is_waiting = _trace(loop, 1.0)
        if is_waiting and max(film.sums.count) == 16:
            monkeypatch.setattr(loop.learner, "learn", learn_meanwhile)
            loop.begin_next(Statistics())
            break
        if is_waiting:
            loop.begin_next(Statistics())
    followed = []
    if learning_ends_first:
        # What was held is there. The rest of the bridge comes first, and a tile goes on where it has its own.
        assert (film.sums.count > 16).sum() == TILE_SIZE**2
        task = loop.take()
        assert task.arm_samples == ArmSamples(16, 8, BRIDGE)
        followed.append(loop.take())
        assert followed[0].tile != task.tile and not loop.has_task
        loop.keep(task, loop.unit(task), _sums(100.0), UnitCosts(), None)
        assert not loop.finish(task)
        seen.append("bridge")
    assert seen == (["bridge", "learned", "bridge"] if learning_ends_first else ["bridge", "bridge", "learned"])
    assert (film.sums.radiance >= 100.0).all()
    while len(followed) < 2:
        followed.append(loop.take())
    assert {task.tile for task in followed} == {0, 1}
    assert all(task.arm_samples.first_sample == 24 and task.arm_samples.arm == CURRENT for task in followed)
    loop.learner.close()


def test_the_bridge_begins_while_the_last_tasks_are_out_and_ends_on_the_film_whatever_is_cut_off() -> None:
    frame = Frame(2 * TILE_SIZE, TILE_SIZE, (0, 0, 2 * TILE_SIZE, TILE_SIZE))
    settings = RenderSettings(samples=64, guiding_method="VMM", guiding_trial=False, deterministic=True)
    film = Film(frame.width, frame.height)
    loop = RenderLoop(RenderRequest(frame, settings), film, 1, lambda guidance, arm: None)
    assert loop.learner is not None
    loop.ready()
    while min(film.sums.count) < 14:
        if _trace(loop, 1.0):
            loop.begin_next(Statistics())
    last = [loop.take(), loop.take()]
    assert [task.arm_samples for task in last] == [ArmSamples(14, 2, CURRENT)] * 2
    # Nobody waits for these two.
    task = loop.take()
    assert task.arm_samples == ArmSamples(16, 8, BRIDGE)
    loop.keep(task, loop.unit(task), _sums(100.0), UnitCosts(), None)
    assert not loop.finish(task)
    assert max(film.sums.count) == 14
    loop.end()
    assert max(film.sums.count) == 22 and film.sums.radiance.max() >= 100.0
    loop.learner.close()


@pytest.mark.parametrize("workers", [1, 2, 5])
def test_tiles_get_their_samples_in_order_whoever_is_slow(workers: int) -> None:
    """Threads end in any order; each iteration is learned from while others are on the bridge."""
    rng, tile_count, samples = np.random.default_rng(workers), 12, 63
    bridge = Bridge(lambda units, sums, weight: None)
    iterations = BridgedIterations(Iterations(samples), bridge)
    iterations.begin([ArmSamples(0, 1, CURRENT)], tile_count)
    done = dict.fromkeys(range(tile_count), 0)
    out: list[Task] = []
    learning: tuple[int, int] | None = None
    bridges, early = 0, 0
    while iterations.has_task or out or learning:
        while iterations.has_task and len(out) < workers:
            task = iterations.take()
            # All before are there, but for bridges, which may come before the last tasks of the iteration before.
            assert done[task.tile] >= task.arm_samples.first_sample or task.arm_samples.arm == BRIDGE
            out.append(task)
            following = iterations.plan(0.0) if iterations.lacks_bridge else None
            if following is not None:
                iterations.bridged = following[1] // 2
                if iterations.bridged:
                    iterations.begin_bridge(following[0], tile_count, 1.0)
                    bridges += 1
        if learning is not None and (not out or rng.random() < 0.2):
            first, count = learning
            learning = None
            iterations.begin([ArmSamples(first, count, CURRENT)], tile_count)
            continue
        task = out.pop(rng.integers(len(out)))
        early += task.arm_samples.arm == BRIDGE and any(one.arm_samples.arm == CURRENT for one in out)
        done[task.tile] += task.arm_samples.sample_count
        if iterations.finish(task):
            following = iterations.plan(0.0)
            if following is not None:
                bridged = iterations.bridged or 0
                learning = following[0] + bridged, following[1] - bridged
    assert set(done.values()) == {samples} and bridges == 6
    assert (early > 0) is (workers > 1)


@pytest.mark.parametrize(
    "settings",
    [
        {"guiding_method": "VMM"},
        {"guiding_method": "OFF", "radiance_cache": "CONVERGING"},
        {"guiding_method": "VMM", "radiance_cache": "CONVERGING"},
    ],
    ids=["guided", "cached", "both"],
)
def test_the_picture_does_not_tell_how_long_learning_took(monkeypatch, settings):
    """Nothing that bridging samples read changes while the learner learns, and it reads nothing of theirs."""
    lengths: list[int] = []

    def counted(*arguments):
        lengths.append(bridge_samples(*arguments))
        return lengths[-1]

    monkeypatch.setattr(render_loop, "bridge_samples", counted)
    method = settings["guiding_method"]
    rest = {name: value for name, value in settings.items() if name != "guiding_method"}
    picture = partial(render, method, 3, scene=partial(corner_scene, (48, 40)), samples=63, guiding_trial=False, **rest)
    first = picture(threads=1).passes["Combined"]
    assert 8 in lengths
    for threads in (2, 16):
        assert np.array_equal(first, picture(threads=threads).passes["Combined"])


def test_all_samples_are_there_and_the_mean_is_kept(monkeypatch):
    with_bridges = render("VMM", 5, scene=partial(corner_scene, (48, 40)), samples=63, guiding_trial=False)
    monkeypatch.setattr(render_loop, "bridge_samples", lambda *_: 0)
    without = render("VMM", 5, scene=partial(corner_scene, (48, 40)), samples=63, guiding_trial=False)
    assert with_bridges.report.path_count == without.report.path_count
    one, other = (result.passes["Combined"][..., :3].astype(float) for result in (with_bridges, without))
    assert not np.array_equal(one, other)
    # Standard error of the difference, of rows as independent samples; four of them.
    rows = (one - other).mean(axis=(1, 2))
    assert abs(rows.mean()) < 4.0 * rows.std(ddof=1) / np.sqrt(len(rows)) + 1e-4


@pytest.mark.parametrize("method", ["SDTREE", "TABLE_RIS", "AUTO"])
def test_what_bridges_go_by_does_not_change_while_it_learns(method):
    one, two = (
        render(
            method, 3, scene=partial(corner_scene, (48, 40)), samples=63, guiding_trial=False, threads=threads,
            deterministic=True,
        ).passes["Combined"]
        for threads in (1, 2)
    )  # fmt: skip
    assert np.array_equal(one, two)
