# SPDX-License-Identifier: GPL-3.0-or-later
"""What is sent to the process, and when processes end; the process is a list of what was sent."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from addon.viewport import host as host_module
from addon.viewport.host import Host, acquire, close_all, drop_spare, release, settle
from engine.settings import RenderSettings
from engine.viewport.view import Plane, Update, View
from tests.helpers.small_scenes import floor_scene, looking_down, material, sun

VIEW = View(looking_down(), Plane(-1, 1, -1, 1), 10, 10, (0, 0, 10, 10))
SETTINGS = RenderSettings(samples=4)


class FakeProcess:
    """Notes what it is told."""

    def __init__(self) -> None:
        self.updates: list[Update] = []
        self.is_alive = False

    def start(self) -> None:
        self.is_alive = True

    def send(self, update: Update) -> None:
        self.updates.append(update)

    def poll(self) -> None:
        pass

    def close(self) -> None:
        self.is_alive = False


@pytest.fixture(autouse=True)
def fake_processes(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.setattr(host_module, "ViewProcess", FakeProcess)
    yield
    close_all()


def started() -> tuple[Host, Any]:
    host = acquire(dict)
    host.take(floor_scene())
    host.show(VIEW, SETTINGS, is_paused=True)
    host.process.updates.clear()
    return host, host.process


def test_only_what_differs_is_sent() -> None:
    host, process = started()
    host.take(floor_scene(lights=[sun()]))
    assert host.show(VIEW, SETTINGS, is_paused=False)
    assert not host.show(replace(VIEW), SETTINGS, is_paused=False)
    host.show(replace(VIEW, width=11), SETTINGS, is_paused=False)
    host.take(floor_scene(lights=[sun()]))
    assert not host.show(replace(VIEW, width=11), SETTINGS, is_paused=False)
    host.show(replace(VIEW, width=11), replace(SETTINGS, samples=5), is_paused=True)
    first, second, third = process.updates
    assert first.scene is not None and first.is_paused is False and first.view is None and first.settings is None
    assert second == Update(view=replace(VIEW, width=11))
    assert third == Update(settings=replace(SETTINGS, samples=5), is_paused=True)


def test_unchanged_parts_of_a_scene_stay_the_same_objects() -> None:
    old = floor_scene(lights=[sun()])
    same, is_changed = settle(old, floor_scene(lights=[sun()]))
    assert same is old and not is_changed
    other, is_changed = settle(old, floor_scene(lights=[sun(3.0)], materials=[material("Red", (1, 0, 0))]))
    assert is_changed
    assert other.meshes is old.meshes and other.instances is old.instances
    assert other.lights is not old.lights and other.materials is not old.materials
    moved = np.eye(4)
    moved[0, 3] = 1.0
    other, is_changed = settle(old, floor_scene(lights=[sun()], transforms=[moved]))
    assert is_changed
    assert other.instances.mesh is old.instances.mesh
    assert other.instances.transform is not old.instances.transform


def test_another_process_gets_everything(monkeypatch: pytest.MonkeyPatch) -> None:
    host, process = started()
    process.is_alive = False
    now = host_module.time.monotonic
    monkeypatch.setattr(host_module.time, "monotonic", lambda: now() + 10.0)
    assert not host.show(VIEW, SETTINGS, is_paused=True), "what ended it is to be read first"
    assert host.show(VIEW, SETTINGS, is_paused=False)
    (sent,) = process.updates
    assert sent == Update(VIEW, host.scene, SETTINGS, 1, False)
    process.is_alive = False
    assert not host.show(VIEW, SETTINGS, is_paused=True), "one that ends at once must not be started again and again"


def test_one_process_is_kept_for_the_next_window() -> None:
    (first, _), (second, other) = started(), started()
    first.show(VIEW, SETTINGS, is_paused=False)
    release(first)
    release(second)
    assert first.process.is_alive and not other.is_alive
    assert first.process.updates[-1] == Update(is_paused=True)
    again, process = started()
    assert again is first
    again.show(VIEW, SETTINGS, is_paused=False)
    assert process.updates == [Update(is_paused=False)]


def test_a_spare_process_ends_after_a_while_or_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    first, process = started()
    release(first)
    assert drop_spare()
    now = host_module.time.monotonic
    monkeypatch.setattr(host_module.time, "monotonic", lambda: now() + host_module.SPARE_SECONDS + 1.0)
    assert not drop_spare()
    assert not process.is_alive
    second, process = started()
    release(second)
    assert not drop_spare(whatever=True)
    assert not process.is_alive


def test_all_processes_end_with_the_file() -> None:
    (first, _), (second, _) = started(), started()
    release(first)
    close_all()
    assert not first.process.is_alive and not second.process.is_alive
    release(second)
    assert not drop_spare()
