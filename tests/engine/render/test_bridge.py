# SPDX-License-Identifier: GPL-3.0-or-later
"""What is traced while learning goes on: which samples, by what, and that the picture does not tell."""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest

from engine.guiding.policy.trial import ArmSamples
from engine.render import bridge as bridges
from engine.render import render_loop
from engine.render.bridge import Bridge, bridge_samples
from engine.state.film import allocate_tile
from engine.state.unit import BRIDGE, CHALLENGER, CURRENT, PLAIN, Unit
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


def _sums(value: float):
    sums = allocate_tile(4, 3)
    sums.radiance[:] = value
    return sums


def test_sums_wait_for_learning_and_what_follows_waits_for_all():
    """In whatever order learning and the last task end."""
    put: list[tuple[int, float, float]] = []

    def take(units, sums, weight):
        put.append((int(units[0].film_index[0]), float(sums.radiance[0, 0]), weight))

    went_on: list[str] = []
    go_on = partial(went_on.append, "on")
    for learning_ends_first in (True, False):
        put.clear()
        went_on.clear()
        bridge = Bridge(take)
        bridge.begin(16, 8, 2, 0.5)
        tasks = [bridge.take(), bridge.take()]
        assert not bridge.has_task
        assert all(task.arm_samples == ArmSamples(16, 8, BRIDGE) for task in tasks)
        sums = _sums(1.0)
        bridge.keep([_unit(0)], sums)
        # The thread's memory is its next unit's.
        sums.radiance[:] = 7.0
        bridge.finish(tasks[0])
        assert not put
        if learning_ends_first:
            bridge.let_go()
            bridge.then(go_on)
            assert put == [(0, 1.0, 0.5)] and not went_on
        bridge.keep([_unit(1)], _sums(2.0))
        bridge.finish(tasks[1])
        if not learning_ends_first:
            assert not put
            bridge.let_go()
            bridge.then(go_on)
        assert put == [(0, 1.0, 0.5), (3, 2.0, 0.5)] and went_on == ["on"]
        assert bridge.take_path_count() == 2 * 3 * 8 and bridge.take_path_count() == 0


def test_without_a_bridge_what_follows_begins_at_once():
    went_on: list[str] = []
    Bridge(lambda *_: None).then(lambda: went_on.append("on"))
    assert went_on == ["on"]


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
