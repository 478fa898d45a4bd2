# SPDX-License-Identifier: GPL-3.0-or-later
"""The host's handle: a process that renders, and processes that do everything else."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import textwrap
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from engine.denoise import library
from engine.processes import memory as memory_module
from engine.scene.description import SceneDescription
from engine.viewport.handle import ViewProcess
from engine.viewport.protocol import DEAD, DONE, FAILED, PAUSED, RENDERING, ViewImage
from engine.viewport.view import Update
from tests.helpers.media_scenes import media_scene, medium, placed
from tests.helpers.seeded_renders import Z_LIMIT, z_score
from tests.helpers.small_scenes import floor_scene, looking_down, pit_scene, sun
from tests.helpers.views import SETTINGS, is_running, result_of, view, wait_for, whole
from tests.helpers.waiting import NEVER, wait_until

posix = pytest.mark.skipif(os.name != "posix", reason="signals")


@pytest.fixture(scope="module")
def process() -> Iterator[ViewProcess]:
    """A process that renders, for many tests."""
    handle = ViewProcess()
    handle.start()
    yield handle
    number = handle.process_id
    handle.close()
    assert number is None or not is_running(number)


def test_a_scene_is_rendered(process: ViewProcess) -> None:
    """A white floor under a sun of 2 W/m2, straight above: 0.5 * 2 / pi."""
    process.send(whole())
    image = result_of(process)
    assert image.pixels.shape == (16, 32, 4) and image.rectangle == (0, 0, 32, 16)
    assert np.allclose(image.pixels[..., :3], 1.0 / np.pi, rtol=1e-4)
    assert process.status.sample == 4


def test_ink_is_shown_and_another_density_of_it(process: ViewProcess) -> None:
    for density in (0.5, 0.2):
        ink = medium("Absorption", Color=(0.5, 0.2, 0.8, 1.0), Density=density)
        scene = media_scene([ink], [placed((50.0, 50.0, 0.5))])
        process.send(Update(view=view(camera=scene.camera), scene=scene, settings=SETTINGS, is_paused=False))
        expected = np.exp(-density * (1.0 - np.array([0.5, 0.2, 0.8])))
        # Slanted rays go up to a hundredth further.
        assert np.allclose(result_of(process).pixels[..., :3], expected, rtol=0.01)


def test_a_camera_alone_is_sent(process: ViewProcess) -> None:
    process.send(whole())
    result_of(process)
    up = looking_down()
    up.transform[1, 1] = up.transform[2, 2] = -1.0
    process.send(Update(view=view(camera=up)))
    assert not result_of(process).pixels[..., :3].any()


@pytest.mark.parametrize("size", [(1, 1), (3, 1), (33, 47)])
def test_windows_of_any_size(process: ViewProcess, size: tuple[int, int]) -> None:
    process.send(whole(width=size[0], height=size[1]))
    assert result_of(process).pixels.shape == (size[1], size[0], 4)


def test_a_border_is_all_that_is_rendered(process: ViewProcess) -> None:
    update = whole()
    process.send(replace(update, view=replace(update.view, region=(5, 3, 20, 9))))
    image = result_of(process)
    assert image.rectangle == (5, 3, 20, 9) and image.pixels.shape == (6, 15, 4)


def test_what_cannot_be_rendered_is_said_and_the_next_can(process: ViewProcess) -> None:
    broken = looking_down()
    broken.transform[0, 0] = np.nan
    process.send(Update(view=view(camera=broken)))
    wait_for(process, lambda: process.status.state == FAILED)
    assert "camera" in process.status.message
    process.send(whole())
    result_of(process)


def test_a_pause_stops_and_its_end_goes_on(process: ViewProcess) -> None:
    process.send(whole(settings=replace(SETTINGS, samples=1 << 16)))
    wait_for(process, lambda: process.status.state == RENDERING)
    process.send(Update(is_paused=True))
    wait_for(process, lambda: process.status.state == PAUSED)
    process.send(replace(whole(), is_paused=False))
    result_of(process)


def test_many_updates_at_once_end_with_the_newest(process: ViewProcess) -> None:
    process.send(whole(settings=replace(SETTINGS, samples=1 << 16)))
    for step in range(50):
        camera = looking_down(10.0 + step)
        process.send(Update(view=view(camera=camera)))
    process.send(replace(whole(), view=view(20, 10)))
    assert result_of(process).pixels.shape == (10, 20, 4)


def test_two_views_at_once_do_not_meet(process: ViewProcess) -> None:
    other = ViewProcess()
    other.start()
    try:
        process.send(whole(width=20, height=10))
        other.send(whole(floor_scene(lights=[sun(4.0)]), width=16, height=8))
        assert np.allclose(result_of(other).pixels[..., :3], 2.0 / np.pi, rtol=1e-4)
        assert np.allclose(result_of(process).pixels[..., :3], 1.0 / np.pi, rtol=1e-4)
    finally:
        other.close()


def test_a_guided_view_has_the_mean_of_an_unguided_one(process: ViewProcess) -> None:
    means: dict[str, list[float]] = {"OFF": [], "VMM": []}
    for method, found in means.items():
        for seed in range(4):
            settings = replace(
                SETTINGS, guiding_method=method, guiding_trial=False, learn_guiding_probability=False, samples=63,
                seed=seed,
            )  # fmt: skip
            process.send(whole(pit_scene(), settings))
            found.append(float(result_of(process).pixels[..., :3].mean()))
    plain, guided = (np.array(found) for found in means.values())
    assert z_score(guided, plain) < Z_LIMIT and not np.isin(guided, plain).any()
    # The test can see a bias of 5%.
    assert z_score(1.05 * guided, plain) > Z_LIMIT


@pytest.mark.skipif(bool(library.problem()), reason="no Open Image Denoise")
def test_a_view_is_denoised(process: ViewProcess) -> None:
    """A floor under a soft lamp: what is left of the noise is smooth."""
    lamp = replace(sun(), kind="AREA", energy=300.0, size_x=3.0, size_y=3.0, transform=looking_down(4.0).transform)
    scene = floor_scene(lights=[lamp])
    spread = {}
    for is_denoised in (False, True):
        settings = replace(SETTINGS, samples=2, use_denoising=is_denoised)
        process.send(whole(scene, settings, width=64, height=64))
        pixels = result_of(process).pixels[..., 0]
        spread[is_denoised] = np.abs(np.diff(pixels, axis=1)).mean() / pixels.mean()
    assert spread[True] < 0.5 * spread[False], process.status


def grouped_floor() -> SceneDescription:
    """A white floor under three suns: one in each of two groups, and one in none."""
    suns = [replace(sun(strength), key=("sun", index)) for index, strength in enumerate((2.0, 1.0, 0.5))]
    suns[0].light_group, suns[1].light_group = 0, 1
    return replace(floor_scene(lights=suns), light_groups=("Key", "Fill"))


def next_picture(process: ViewProcess, states: set[str]) -> np.ndarray:
    """What is shown by the last update, and the states that the process has had until then."""
    images: list[ViewImage] = []

    def is_shown() -> bool:
        states.add(process.status.state)
        image = process.read_image()
        images.extend([] if image is None else [image])
        return bool(images) and images[-1].update == process.sent

    wait_for(process, is_shown)
    return images[-1].pixels[..., :3]


def test_light_groups_are_mixed_without_another_render(process: ViewProcess) -> None:
    """The first factors have groups kept; from then on the same samples are shown by others."""
    ones = {"Key": (1.0, 1.0, 1.0), "Fill": (1.0, 1.0, 1.0)}
    process.send(whole(grouped_floor()))
    plain = result_of(process).pixels[..., :3]
    process.send(Update(mix=ones | {"Key": (3.0, 1.0, 0.0)}))
    colored = result_of(process).pixels[..., :3]
    key = 0.5 * (colored[..., 0] - plain[..., 0])
    assert key.mean() == pytest.approx(2.0 / (2.0 * np.pi), rel=0.1)
    assert np.allclose(colored[..., 1], plain[..., 1], rtol=1e-5)
    assert np.allclose(colored[..., 2], plain[..., 2] - key, atol=1e-5)
    states: set[str] = set()
    process.send(Update(mix={"Key": (0.0, 0.0, 0.0), "Fill": (2.0, 2.0, 2.0)}))
    fill = next_picture(process, states)[..., 0] - plain[..., 0] + key
    assert fill.mean() == pytest.approx(1.0 / (2.0 * np.pi), rel=0.1)
    process.send(Update(mix=ones | {"Gone": (5.0, 5.0, 5.0)}))
    assert np.allclose(next_picture(process, states), plain, rtol=1e-5)
    assert states == {DONE}, "no samples are traced again"


def test_light_groups_are_mixed_while_a_view_renders(process: ViewProcess) -> None:
    """Without a restart: samples of a pixel only get more."""
    scene, settings = grouped_floor(), replace(SETTINGS, samples=1 << 16)
    process.send(replace(whole(scene, settings), mix={"Key": (2.0,) * 3, "Fill": (1.0,) * 3}))
    wait_for(process, lambda: process.status.update == process.sent and process.status.sample > 8)
    counts = [process.status.sample]
    for strength in (0.0, 4.0):
        process.send(Update(mix={"Key": (strength,) * 3, "Fill": (1.0,) * 3}))
        states: set[str] = set()
        mean = next_picture(process, states).mean()
        assert states == {RENDERING}
        assert mean == pytest.approx((1.5 + 2.0 * strength) / (2.0 * np.pi), rel=0.1)
        process.poll()
        counts.append(process.status.sample)
    assert counts == sorted(counts) and counts[0] > 8
    process.send(whole())
    result_of(process)


@posix
@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="reads /proc")
def test_a_view_that_is_done_takes_no_processor(process: ViewProcess) -> None:
    """At most 2% of one processor, over two seconds."""
    process.send(whole())
    result_of(process)

    def ticks() -> int:
        return sum(map(int, Path(f"/proc/{process.process_id}/stat").read_text().rpartition(")")[2].split()[11:13]))

    def rests() -> bool:
        before = ticks()
        time.sleep(2.0)
        return ticks() - before <= 0.02 * 2.0 * os.sysconf("SC_CLK_TCK")

    # What it does after the picture may take it a while.
    wait_until(rests)


# Faults

HELLO = """
    import json, sys, time
    config = json.loads(sys.stdin.readline())
    sys.path[:] = config["path"]
    from engine.viewport.protocol import Block, Status
    block = Block.attach(config["block"])
"""


@pytest.fixture
def faulty(tmp_path: Path) -> Iterator[Callable[..., ViewProcess]]:
    """Makes handles whose process is a script; closes them, and looks for what they left."""
    made: list[ViewProcess] = []
    processes: list[int | None] = []

    def make(*script: str, **options: float) -> ViewProcess:
        handle = ViewProcess(**options)  # type: ignore[arg-type]
        path = tmp_path / f"process{len(made)}.py"
        path.write_text("".join(textwrap.dedent(part) for part in (HELLO, *script)))
        handle.script = path
        handle.start()
        made.append(handle)
        processes.append(handle.process_id)
        return handle

    yield make
    for handle, number in zip(made, processes, strict=True):
        handle.close()
        assert handle.status.state == DEAD
        assert number is None or not is_running(number)


def end_of(handle: ViewProcess) -> str:
    wait_for(handle, lambda: handle.status.state == DEAD)
    assert not handle.is_alive and handle.read_image() is None
    handle.send(whole())
    return handle.status.message


@posix
def test_a_killed_process_is_noticed_and_another_renders(faulty: Callable[..., ViewProcess]) -> None:
    handle = faulty("sys.stdin.read()\n")
    os.kill(handle.process_id, signal.SIGKILL)
    assert "SIGKILL" in end_of(handle)


def test_a_process_that_ends_says_why(faulty: Callable[..., ViewProcess]) -> None:
    assert "code 3: no such luck" in end_of(faulty("print('no such luck', file=sys.stderr); sys.exit(3)\n"))


@posix
def test_a_hung_process_is_ended(faulty: Callable[..., ViewProcess]) -> None:
    """It reads nothing, and does not mind being asked to go."""
    handle = faulty(
        "import signal; signal.signal(15, signal.SIG_IGN); block.write_status(Status('RENDERING')); time.sleep(1e6)\n",
        answer_timeout=0.5,
    )
    # Whoever waits for it waits for ever: nobody else finds out that it hangs.
    for _ in range(200):
        handle.send(whole())
    assert "not answered" in end_of(handle)


def test_a_process_that_never_starts_is_ended(faulty: Callable[..., ViewProcess]) -> None:
    handle = faulty("time.sleep(1e6)\n", start_timeout=0.3)
    handle.send(whole())
    assert "not answered" in end_of(handle)


def test_a_host_that_slept_does_not_blame_the_process(
    faulty: Callable[..., ViewProcess], monkeypatch: pytest.MonkeyPatch
) -> None:
    handle = faulty("block.write_status(Status('RENDERING')); sys.stdin.read()\n", answer_timeout=NEVER)
    handle.send(whole())
    wait_for(handle, lambda: handle.status.state == RENDERING)
    now = time.monotonic
    monkeypatch.setattr(time, "monotonic", lambda: now() + 4.0 * NEVER)
    assert handle.poll().state == RENDERING


def test_without_shared_memory_the_view_says_so(
    faulty: Callable[..., ViewProcess], monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_arguments: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(memory_module.os, "posix_fallocate", refuse, raising=False)
    handle = faulty()
    assert handle.process_id is None
    assert handle.status.message == "No shared memory for the viewport: No space left on device"


def test_without_shared_memory_for_the_scene_the_view_says_so(
    faulty: Callable[..., ViewProcess], monkeypatch: pytest.MonkeyPatch
) -> None:
    handle = faulty("sys.stdin.read()\n")

    def refuse(*_arguments: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(memory_module.SharedMemory, "reserve", refuse)
    handle.send(whole())
    assert handle.status.message == "No shared memory for the scene: No space left on device"


def test_without_a_python_the_view_says_so() -> None:
    handle = ViewProcess(interpreter="/nowhere/python")
    handle.start()
    assert "could not be started" in handle.status.message


@posix
@pytest.mark.parametrize("how", ["kill -9 $$", "exit 3"])
def test_the_process_goes_with_its_host_however_that_goes(how: str, tmp_path: Path) -> None:
    code = (
        "import os, sys, time; from engine.viewport.handle import ViewProcess; p = ViewProcess(); p.start(); "
        "print(p.process_id, flush=True); time.sleep(1.0); "
        + ("os.kill(os.getpid(), 9)" if "kill" in how else "os._exit(3)")
    )
    root = Path(__file__).resolve().parents[3]
    before = set(os.listdir("/dev/shm")) if os.path.isdir("/dev/shm") else set()
    host = subprocess.run([sys.executable, "-c", code], cwd=root, capture_output=True, text=True)
    number = int(host.stdout)
    wait_until(lambda: not is_running(number))
    if os.path.isdir("/dev/shm"):
        assert not {name for name in set(os.listdir("/dev/shm")) - before if "neuralguide" in name}
