# SPDX-License-Identifier: GPL-3.0-or-later
"""Frames whose process ends before they do: killed or asked to, at any moment, they go on to the same picture."""

from __future__ import annotations

import os
import random
import signal
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR
import pytest

from tests.helpers.command_line import names, run_here
from tests.helpers.waiting import wait_until

ROOT = Path(__file__).resolve().parents[2]
posix = pytest.mark.skipif(os.name != "posix", reason="signals")
#: A few seconds of work, by one thread.
PLAIN = ["-E", "NEURALGUIDE", "-t", "1", "--set", "guiding_method=OFF", "--set", "radiance_cache=OFF"]


def pixels(path: Path) -> Any:
    with OpenEXR.File(str(path)) as file:
        return np.array(file.channels()["RGBA"].pixels)


def scene_file(blender: Any, samples: int, *, threshold: float = 0.0) -> None:
    """Have the open file take that many samples of a larger picture."""
    scene = blender.context.scene
    scene.render.resolution_x, scene.render.resolution_y = 96, 72
    scene.neuralguide.samples = samples
    if threshold:
        scene.cycles.use_adaptive_sampling, scene.cycles.adaptive_threshold = True, threshold
    blender.ops.wm.save_mainfile()


class Victim:
    """A process that renders frame 1 until a signal ends it."""

    def __init__(self, blend_file: Path, *options: str) -> None:
        line = [sys.executable, "-m", "addon", str(blend_file), "--checkpoint", "0.05", *options]
        self._process = subprocess.Popen(
            [*line, "-o", "//x_", "-f", "1"], cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
        )
        self._checkpoint = blend_file.with_name("x_0001.exr.ngcheckpoint")

    def end(self, number: int, delay: float) -> tuple[int, str]:
        """Send a signal so long after the next checkpoint; returns the exit code and what was said."""
        before = self._stamp()
        wait_until(lambda: self._stamp() != before or self._process.poll() is not None)
        time.sleep(delay)
        self._process.send_signal(number)
        said, _ = self._process.communicate(timeout=300)
        return self._process.returncode, said

    def _stamp(self) -> int:
        return self._checkpoint.stat().st_mtime_ns if self._checkpoint.exists() else 0


def kill_often(blend_file: Path, times: int, seed: int, options: Sequence[str] = PLAIN) -> None:
    """Kill a frame at random moments, going on with it each time."""
    moments = random.Random(seed)
    for index in range(times):
        Victim(blend_file, *options, "--resume").end(signal.SIGKILL, 0.3 * moments.random())
        kept = blend_file.with_name("x_0001.exr.ngcheckpoint")
        assert index or kept.exists(), "it is to be killed before its end"


@posix
@pytest.mark.parametrize(
    ("times", "threshold", "samples"),
    [(1, 0.001, 1200), *(pytest.param(10, threshold, 3000, marks=pytest.mark.slow) for threshold in (0.0, 0.001))],
)
def test_killed_frames_go_on_to_the_same_bits(
    blend_file: Path, blender: Any, tmp_path: Path, monkeypatch: Any, times: int, threshold: float, samples: int
) -> None:
    scene_file(blender, samples, threshold=threshold)
    assert run_here(monkeypatch, str(blend_file), *PLAIN, "-o", "//whole_", "-f", "1") == 0
    kill_often(blend_file, times, seed=times)
    assert run_here(monkeypatch, str(blend_file), *PLAIN, "--resume", "-o", "//x_", "-f", "1") == 0
    assert names(tmp_path) == ["whole_0001.exr", "x_0001.exr"]
    assert np.array_equal(pixels(tmp_path / "x_0001.exr"), pixels(tmp_path / "whole_0001.exr"))


@posix
@pytest.mark.slow
def test_killed_frames_that_learn_go_on(blend_file: Path, blender: Any, tmp_path: Path, monkeypatch: Any) -> None:
    """At the defaults: guiding and cache are automatic. Sums of 7000 pixels of 3000 samples are good for 0.1%."""
    scene_file(blender, 3000)
    line = [str(blend_file), "-E", "NEURALGUIDE", "-t", "1"]
    assert run_here(monkeypatch, *line, "-o", "//whole_", "-f", "1") == 0
    kill_often(blend_file, 3, seed=7, options=line[1:])
    assert run_here(monkeypatch, *line, "--resume", "-o", "//x_", "-f", "1") == 0
    assert names(tmp_path) == ["whole_0001.exr", "x_0001.exr"]
    one, other = (pixels(tmp_path / f"{name}_0001.exr") for name in ("x", "whole"))
    assert one.mean() == pytest.approx(other.mean(), rel=3e-3)
    np.testing.assert_allclose(one, other, atol=0.1 * other.max())


@posix
def test_a_frame_that_is_asked_to_end_says_how_it_goes_on(
    blend_file: Path, blender: Any, tmp_path: Path, monkeypatch: Any, capfd: Any
) -> None:
    scene_file(blender, 1200)
    code, said = Victim(blend_file, *PLAIN).end(signal.SIGTERM, 0.0)
    kept = tmp_path / "x_0001.exr.ngcheckpoint"
    assert code == 143 and f"frame 1 is kept as far as it came, in {kept}: --resume goes on from it" in said
    line = [str(blend_file), *PLAIN, "--set", "seed=1"]
    assert run_here(monkeypatch, *line, "--resume-or-fail", "-o", "//x_", "-f", "1") == 1
    assert "was made by other settings (seed)" in capfd.readouterr().err and kept.exists()
    line[-1] = "seed=0"
    assert run_here(monkeypatch, *line, "--resume", "-o", "//x_", "-f", "1") == 0
    assert "frame 1 goes on from" in capfd.readouterr().out
    assert names(tmp_path) == ["x_0001.exr"]


@posix
def test_layers_that_were_finished_are_not_rendered_again(
    blend_file: Path, blender: Any, tmp_path: Path, monkeypatch: Any, capfd: Any
) -> None:
    """The process is asked to end as the second of two view layers begins, which is not finished before it is heard."""
    from engine.render.checkpointing import Checkpointing

    scene_file(blender, 16)
    second = blender.context.scene.view_layers.new("Second")
    second.use_pass_z, second.samples = True, 300
    blender.ops.wm.save_mainfile()
    line = [str(blend_file), *PLAIN, "-F", "OPEN_EXR_MULTILAYER"]
    assert run_here(monkeypatch, *line, "-o", "//whole_", "-f", "1") == 0
    real, begun = Checkpointing.begin, []

    def begin(self: Any, request: Any) -> Any:
        begun.append(1)
        if len(begun) == 2:
            os.kill(os.getpid(), signal.SIGTERM)
        return real(self, request)

    with monkeypatch.context() as patch:
        patch.setattr(Checkpointing, "begin", begin)
        assert run_here(patch, *line, "-o", "//x_", "-f", "1") == 143
    assert "x_0001.exr.0.ngcheckpoint" in names(tmp_path)
    capfd.readouterr()
    assert run_here(monkeypatch, *line, "--resume", "-o", "//x_", "-f", "1") == 0
    assert "frame 1 goes on from 16 samples" in capfd.readouterr().out
    assert names(tmp_path) == ["whole_0001.exr", "x_0001.exr"]
    with OpenEXR.File(str(tmp_path / "x_0001.exr")) as one, OpenEXR.File(str(tmp_path / "whole_0001.exr")) as other:
        assert len(one.parts) == len(other.parts) > 1
        for part, same in zip(one.parts, other.parts, strict=True):
            for name, channel in part.channels.items():
                assert np.array_equal(channel.pixels, same.channels[name].pixels), name


def test_finished_frames_get_more_samples(
    blend_file: Path, tmp_path: Path, monkeypatch: Any, capfd: Any
) -> None:
    from addon import engine

    line = [str(blend_file), *PLAIN, "--set", "samples=12", "-o", "//x_"]
    assert run_here(monkeypatch, *line, "-f", "1") == 0
    assert run_here(monkeypatch, *line, "--add-samples", "20", "-f", "1") == 1
    assert "render the frame with --keep-film first" in capfd.readouterr().err
    assert run_here(monkeypatch, *line, "--keep-film", "-f", "1") == 0
    for samples in (32, 52):
        assert run_here(monkeypatch, *line, "--add-samples", "20", "-f", "1") == 0
        assert engine.outcomes[-1].report.sample_count == samples
        assert names(tmp_path) == ["x_0001.exr", "x_0001.exr.ngfilm"]


def test_parts_of_a_frame_make_one_picture(blend_file: Path, tmp_path: Path, monkeypatch: Any, capfd: Any) -> None:
    """As several machines render them."""
    line = [str(blend_file), *PLAIN, "--set", "samples=12"]
    for seed in ("1", "2"):
        part = ["--set", f"seed={seed}", "--keep-film", "-o", f"//part_{seed}_", "-f", "1"]
        assert run_here(monkeypatch, *line, *part) == 0
    merged = ["--merge", "//part_1_####.exr", "--merge", "//part_2_####.exr"]
    assert run_here(monkeypatch, *line, *merged, "-o", "//x_", "-f", "1") == 0
    parts = [pixels(tmp_path / f"part_{seed}_0001.exr") for seed in "12"]
    np.testing.assert_allclose(pixels(tmp_path / "x_0001.exr"), sum(parts) / 2, rtol=1e-5, atol=1e-7)
    assert not np.array_equal(*parts)
    assert run_here(monkeypatch, *line, "--merge", "//part_3_####.exr", "-o", "//y_", "-f", "1") == 1
    assert "there is no film" in capfd.readouterr().err and not (tmp_path / "y_0001.exr").exists()


def test_a_folder_that_takes_no_checkpoint_costs_no_picture(
    blend_file: Path, blender: Any, tmp_path: Path, monkeypatch: Any, capfd: Any
) -> None:
    from engine.render import checkpointing

    def refuse(*_args: Any) -> None:
        raise OSError(30, "Read-only file system")

    monkeypatch.setattr(checkpointing, "save_checkpoint", refuse)
    line = [str(blend_file), *PLAIN, "--keep-film", "-o", "//x_", "-f", "1"]
    assert run_here(monkeypatch, *line) == 0
    assert names(tmp_path) == ["x_0001.exr"]
    assert "x_0001.exr.ngcheckpoint cannot be written (Read-only file system)" in capfd.readouterr().err
