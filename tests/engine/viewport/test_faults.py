# SPDX-License-Identifier: GPL-3.0-or-later
"""What goes wrong with a process that renders: the view says so, nothing is left behind, the next one works."""

from __future__ import annotations

import os
import resource
import signal
import threading
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from engine.render.session import Session
from engine.viewport.handle import ViewProcess
from engine.viewport.protocol import DEAD, FAILED, RENDERING
from engine.viewport.view import Update
from tests.helpers.small_scenes import floor_scene, sun
from tests.helpers.views import SETTINGS, is_running, result_of, view, wait_for, whole
from tests.helpers.waiting import NEVER, wait_until

pytestmark = pytest.mark.skipif(not Path("/proc/self/fd").is_dir(), reason="reads /proc")

#: Goes on for as long as it takes.
ENDLESS = whole(settings=replace(SETTINGS, samples=1 << 16))


def left_behind() -> tuple[int, set[str]]:
    """Open files of this process, and names in shared memory."""
    shared = Path("/dev/shm")
    return len(os.listdir("/proc/self/fd")), set(os.listdir(shared)) if shared.is_dir() else set()


@pytest.fixture
def process(request: pytest.FixtureRequest) -> Iterator[ViewProcess]:
    """A process that has rendered once; at the end it works, or is gone, and so is all that it had.

    Its parameter is after how much silence it counts as hung [s].
    """
    before = left_behind()
    handle = ViewProcess(answer_timeout=getattr(request, "param", NEVER))
    handle.start()
    first = handle.process_id
    handle.send(whole())
    result_of(handle)
    yield handle
    # Whatever has happened, the next one renders.
    handle.start()
    handle.send(whole())
    assert np.allclose(result_of(handle).pixels[..., :3], 1.0 / np.pi, rtol=1e-4)
    last = handle.process_id
    handle.close()
    assert last is not None and not is_running(last)
    assert first is not None and not is_running(first)
    assert left_behind() == before


def end_of(handle: ViewProcess) -> str:
    """What is said of a process that has ended."""
    number = handle.process_id
    wait_for(handle, lambda: handle.status.state == DEAD)
    assert not handle.is_alive and (number is None or not is_running(number))
    return handle.status.message


def rendering(handle: ViewProcess) -> int:
    """Have it render without end; the process's number."""
    handle.send(ENDLESS)
    wait_for(handle, lambda: handle.status.state == RENDERING and handle.status.update == handle.sent)
    assert handle.process_id is not None
    return handle.process_id


def test_a_process_killed_while_it_renders(process: ViewProcess) -> None:
    os.kill(rendering(process), signal.SIGKILL)
    assert end_of(process) == "The viewport's process was ended by SIGKILL, perhaps for want of memory"


@pytest.mark.parametrize("process", [6.0], indirect=True)
def test_a_process_stopped_while_it_renders(process: ViewProcess) -> None:
    os.kill(rendering(process), signal.SIGSTOP)
    assert end_of(process) == "The viewport's process has not answered for 6 s"


@pytest.mark.parametrize("process", [6.0], indirect=True)
def test_a_process_stopped_while_it_rests_is_found_with_the_next_change(process: ViewProcess) -> None:
    assert process.process_id is not None
    os.kill(process.process_id, signal.SIGSTOP)
    stat = Path(f"/proc/{process.process_id}/stat")
    wait_until(lambda: stat.read_text().rpartition(")")[2].split()[0] == "T")
    # Blender must not wait for a process that is stopped: that would be for ever.
    for _ in range(100):
        process.poll()
        process.send(Update(view=view(20, 10)))
    assert end_of(process) == "The viewport's process has not answered for 6 s"


def limit(handle: ViewProcess, kind: int, most: int) -> None:
    """Have a process get no more of something."""
    assert handle.process_id is not None
    resource.prlimit(handle.process_id, kind, (most, resource.getrlimit(kind)[1]))


def used_addresses(handle: ViewProcess) -> int:
    """Bytes of addresses that a process uses."""
    pages = int(Path(f"/proc/{handle.process_id}/statm").read_text().split()[0])
    return pages * resource.getpagesize()


def test_a_view_that_memory_is_too_small_for(process: ViewProcess) -> None:
    """The process says so, and renders a smaller one."""
    limit(process, resource.RLIMIT_AS, used_addresses(process) + (64 << 20))
    process.send(whole(width=8000, height=4000))
    wait_for(process, lambda: process.status.state in (FAILED, DEAD))
    assert "emory" in process.status.message and "Traceback" not in process.status.message
    if process.is_alive:
        limit(process, resource.RLIMIT_AS, resource.getrlimit(resource.RLIMIT_AS)[1])


def test_a_scene_that_memory_is_too_small_for(process: ViewProcess) -> None:
    limit(process, resource.RLIMIT_AS, used_addresses(process) + (16 << 20))
    scene = floor_scene(lights=[sun()])
    scene.meshes[0] = replace(scene.meshes[0], key="large", vertices=np.zeros((4_000_000, 3), np.float32))
    process.send(Update(scene=scene))
    assert "ut of memory" in end_of(process)


def test_no_shared_memory_for_pictures(process: ViewProcess) -> None:
    """A limit on files holds for those that lie in memory too."""
    limit(process, resource.RLIMIT_FSIZE, 1 << 20)
    process.send(whole(width=640, height=480))
    wait_for(process, lambda: process.status.state in (FAILED, DEAD))
    assert process.status.state == FAILED and "No shared memory for pictures" in process.status.message
    limit(process, resource.RLIMIT_FSIZE, resource.getrlimit(resource.RLIMIT_FSIZE)[1])


def test_two_views_and_a_render_at_once(process: ViewProcess) -> None:
    """Each has its own picture: a floor under suns of 2, 4 and 6 W/m2."""
    other = ViewProcess()
    other.start()
    session = Session(SETTINGS)
    session.load(floor_scene(lights=[sun(6.0)]))
    means: list[float] = []
    render = threading.Thread(
        target=lambda: means.extend(session.render().passes["Combined"][..., 0].mean() for _ in range(20))
    )
    try:
        render.start()
        for width in (20, 40, 60):
            process.send(whole(width=width))
            other.send(whole(floor_scene(lights=[sun(4.0)]), width=width))
            assert np.allclose(result_of(process).pixels[..., :3], 1.0 / np.pi, rtol=1e-4)
            assert np.allclose(result_of(other).pixels[..., :3], 2.0 / np.pi, rtol=1e-4)
    finally:
        render.join()
        other.close()
        session.close()
    assert len(means) == 20 and np.allclose(means, 3.0 / np.pi, rtol=1e-4)


@pytest.mark.slow
def test_a_window_of_8k(process: ViewProcess) -> None:
    process.send(whole(width=7680, height=4320, settings=replace(SETTINGS, samples=1, threads=0)))
    image = result_of(process)
    assert image.pixels.shape == (4320, 7680, 4)
    assert np.allclose(image.pixels[::97, ::97, :3], 1.0 / np.pi, rtol=1e-4)


def test_a_region_of_one_pixel(process: ViewProcess) -> None:
    update = whole(settings=replace(SETTINGS, guiding_method="VMM", samples=16))
    assert update.view is not None
    process.send(replace(update, view=replace(update.view, region=(7, 3, 8, 4))))
    image = result_of(process)
    assert image.pixels.shape == (1, 1, 4) and image.rectangle == (7, 3, 8, 4)
