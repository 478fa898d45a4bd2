# SPDX-License-Identifier: GPL-3.0-or-later
"""Views of a floor, and processes that render them: what to send, and waiting for what comes of it."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

from engine.scene.description import Camera, SceneDescription
from engine.settings import RenderSettings
from engine.viewport.handle import ViewProcess
from engine.viewport.protocol import DEAD, DONE, FAILED, ViewImage
from engine.viewport.view import Plane, Update, View
from tests.helpers.small_scenes import floor_scene, looking_down, sun
from tests.helpers.waiting import wait_until

SETTINGS = RenderSettings(samples=4, guiding_method="OFF", threads=1)


def view(width: int = 32, height: int = 16, camera: Camera | None = None) -> View:
    return View(
        looking_down() if camera is None else camera, Plane(-0.2, 0.2, -0.1, 0.1), width, height,
        (0, 0, width, height),
    )  # fmt: skip


def whole(scene: SceneDescription | None = None, settings: RenderSettings = SETTINGS, **options: int) -> Update:
    scene = floor_scene(lights=[sun()]) if scene is None else scene
    return Update(view=view(**options), scene=scene, settings=settings, is_paused=False)


def wait_for(process: ViewProcess, condition: Callable[[], bool]) -> None:
    """Return once `condition` holds of what the process has said."""

    def holds() -> bool:
        process.poll()
        return condition()

    wait_until(holds, 0.005)


def result_of(process: ViewProcess) -> ViewImage:
    """The picture at full resolution of what was sent last."""
    images: list[ViewImage] = []

    def has_ended() -> bool:
        image = process.read_image()
        if image is not None:
            images.append(image)
        return process.status.state in (DONE, FAILED, DEAD) and not process.is_waiting

    wait_for(process, has_ended)
    assert process.status.state == DONE, process.status
    image = process.read_image()
    newest = images[-1] if image is None else image
    assert newest.update == process.sent and newest.divider == 1
    return newest


def is_running(number: int) -> bool:
    try:
        os.kill(number, 0)
    except ProcessLookupError:
        return False
    status = Path(f"/proc/{number}/stat")
    return not status.exists() or status.read_text().rpartition(")")[2].split()[0] != "Z"
