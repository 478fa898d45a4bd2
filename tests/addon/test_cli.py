# SPDX-License-Identifier: GPL-3.0-or-later
"""`python -m addon` end to end, one process for several things: starting Blender takes a second."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import OpenEXR
import pytest

from tests.helpers.command_line import names, run_here
from tests.helpers.fake_engine import FakeEngine

ROOT = Path(__file__).resolve().parents[2]


def command(*arguments: str, cwd: Path | None = None) -> subprocess.CompletedProcess[str]:
    """Run the command line as a user would, from the repository root."""
    return subprocess.run(
        [sys.executable, "-m", "addon", *arguments], cwd=cwd or ROOT, capture_output=True, text=True, timeout=300
    )


def test_frames_are_named_as_blender_names_them(
    blend_file: Path, tmp_path: Path, monkeypatch: Any, cube_scene: Any
) -> None:
    fake = FakeEngine(monkeypatch)
    assert run_here(monkeypatch, "-b", str(blend_file), "-E", "NEURALGUIDE", "-o", "//render_##", "-f", "1,+1,-0") == 0
    assert names(tmp_path) == ["render_01.exr", "render_04.exr", "render_06.exr"]
    assert [frame for _, frame in fake.exported] == [1, 4, 6]


def test_options_act_in_order(blend_file: Path, tmp_path: Path, monkeypatch: Any) -> None:
    FakeEngine(monkeypatch)
    line = "-o //a_ -F PNG -s 2 -e 5 -j 3 -a -x 0 -o //b_# -F OPEN_EXR -f 7 -o //late_"
    assert run_here(monkeypatch, str(blend_file), *line.split()) == 0
    assert names(tmp_path) == ["a_0002.png", "a_0005.png", "b_7"]


def test_scene_threads_and_formats(blend_file: Path, tmp_path: Path, monkeypatch: Any) -> None:
    fake = FakeEngine(monkeypatch)
    line = "-S Two -F OPEN_EXR_MULTILAYER -o //m_ -f 1 -t 1"
    assert run_here(monkeypatch, str(blend_file), *line.split()) == 0
    with OpenEXR.File(str(tmp_path / "m_0001.exr")) as file:
        assert any("ViewLayer.Combined" in name for part in file.parts for name in part.channels)
    assert fake.sessions[0].settings.threads == 1
    import bpy

    assert bpy.context.scene.name == "Two"


def test_settings_are_set_where_they_belong(blend_file: Path, tmp_path: Path, monkeypatch: Any) -> None:
    fake = FakeEngine(monkeypatch)
    line = "--set samples=9 --set experiment.strata=8 --set use_nee=off -o //s_ -f 1"
    assert run_here(monkeypatch, str(blend_file), *line.split()) == 0
    settings = fake.sessions[0].settings
    assert (settings.samples, settings.strata, settings.use_nee) == (9, 8, False)


def test_relative_frames(blend_file: Path, tmp_path: Path, monkeypatch: Any) -> None:
    FakeEngine(monkeypatch)
    assert run_here(monkeypatch, str(blend_file), "-s", "+1", "-e", "-0", "-o", "//r_", "-a") == 0
    assert names(tmp_path) == ["r_0004.exr", "r_0005.exr"]  # Blender's -e -N counts from the frame before the last


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["-S", "Three"], "-S Three: no such scene; there are Scene, Two"),
        (["-E", "LUX"], "-E LUX: no such render engine; there are"),
        (["-F", "XYZ"], "-F XYZ: no such format"),
        (["-f", "+2..-3"], "-f +2..-3: frame 3 is before frame 5"),
        (["nothing.blend"], "there is no file nothing.blend"),
    ],
)
def test_what_is_not_there_is_named(
    blend_file: Path, monkeypatch: Any, capsys: Any, arguments: list[str], message: str
) -> None:
    assert run_here(monkeypatch, str(blend_file), *arguments, "-f", "1") == 2
    assert message in capsys.readouterr().err


def test_a_failed_frame_fails_the_command_and_the_next_is_tried(
    blend_file: Path, tmp_path: Path, monkeypatch: Any, capsys: Any
) -> None:
    fake = FakeEngine(monkeypatch)
    fake.export_error = ValueError("Cube: vertex 3 is NaN")
    assert run_here(monkeypatch, str(blend_file), "-o", "//x_", "-f", "1,2") == 1
    error = capsys.readouterr().err
    assert "frame 1: Cube: vertex 3 is NaN" in error.replace("Error: ", "")
    assert "2 frame(s) failed" in error


def test_frames_that_are_there_are_left_and_the_rest_is_rendered(
    blend_file: Path, tmp_path: Path, monkeypatch: Any, capfd: Any
) -> None:
    """Without --resume all is new."""
    fake = FakeEngine(monkeypatch)
    line = [str(blend_file), "-E", "NEURALGUIDE", "-o", "//x_", "-f", "2"]
    assert run_here(monkeypatch, *line) == 0
    line[-1] = "1..3"
    assert run_here(monkeypatch, *line[:-2], "--resume", *line[-2:]) == 0
    assert [frame for _, frame in fake.exported] == [2, 1, 3]
    assert "frame 2 is left as it is" in capfd.readouterr().out
    assert run_here(monkeypatch, *line) == 0
    assert [frame for _, frame in fake.exported] == [2, 1, 3, 1, 2, 3]


def test_a_frame_that_fails_leaves_no_placeholder(blend_file: Path, tmp_path: Path, monkeypatch: Any) -> None:
    """Else nobody would try it again."""
    fake = FakeEngine(monkeypatch)
    fake.export_error = ValueError("Cube: vertex 3 is NaN")
    line = ["-b", str(blend_file), "-E", "NEURALGUIDE", "-o", "//x_", "--resume", "-f", "1"]
    assert run_here(monkeypatch, *line) == 1
    assert names(tmp_path) == []
    fake.export_error = None
    assert run_here(monkeypatch, *line) == 0
    assert names(tmp_path) == ["x_0001.exr"]


def test_an_unwritable_folder_fails_the_command(
    blend_file: Path, tmp_path: Path, monkeypatch: Any, capsys: Any
) -> None:
    FakeEngine(monkeypatch)
    (tmp_path / "file").write_text("no folder")
    assert run_here(monkeypatch, str(blend_file), "-o", str(tmp_path / "file" / "x_"), "-f", "1") == 1
    assert "frame 1:" in capsys.readouterr().err


def test_a_file_of_an_earlier_run_does_not_count(
    blend_file: Path, tmp_path: Path, monkeypatch: Any, capsys: Any
) -> None:
    """A frame that is there already and cannot be replaced is a failure, not a success."""
    from addon import output_files

    old = tmp_path / "x_0001.exr"
    old.write_bytes(b"old")
    os.utime(old, (1e9, 1e9))
    assert not output_files.was_written(old, 1e9 + 60)
    assert output_files.was_written(old, 1e9)
    old.write_bytes(b"")
    assert not output_files.was_written(old, 0.0)


FORMATS = {
    "PNG": ".png",
    "JPEG": ".jpg",
    "OPEN_EXR": ".exr",
    "OPEN_EXR_MULTILAYER": ".exr",
}

#: Runs the command line with a fake session, where no file may grow beyond a size and the rescue folder is given.
FULL_DISK = """
import resource, signal, sys, tempfile
import numpy
sys.path.insert(0, {root!r})
from pytest import MonkeyPatch
from tests.helpers.fake_engine import FakeEngine, FakeSession
noise = numpy.random.default_rng(1)
images = FakeSession.images
def noisy(self, passes):
    return {{name: image + noise.random(image.shape, "f4") for name, image in images(self, passes).items()}}
FakeSession.images = noisy
FakeEngine(MonkeyPatch())
from addon.__main__ import main
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, ({limit}, {limit}))
tempfile.tempdir = {rescue!r}
sys.exit(main(sys.argv[1:]))
"""


def render_on_full_disk(blend_file: Path, output: Path, rescue: Path, form: str, limit: int) -> Any:
    code = FULL_DISK.format(root=str(ROOT), limit=limit, rescue=str(rescue))
    line = ["-b", str(blend_file), "-F", form, "-o", str(output) + "/x_", "-f", "1,2"]
    # -B: Python puts byte code in place by halves where files may not grow.
    return subprocess.run([sys.executable, "-B", "-c", code, *line], capture_output=True, text=True, timeout=300)


@pytest.mark.skipif(sys.platform == "win32", reason="no limit on the size of files")
@pytest.mark.parametrize("form", FORMATS)
def test_a_disk_that_fills_fails_every_frame_with_a_sentence(blend_file: Path, tmp_path: Path, form: str) -> None:
    """Blender calls half a PNG or EXR file saved."""
    output = tmp_path / "out"
    done = render_on_full_disk(blend_file, output, output, form, 700)
    assert done.returncode == 1, done.stdout + done.stderr
    assert "2 frame(s) failed" in done.stderr
    for frame in (1, 2):
        assert f"frame {frame}: " in done.stderr and f"x_000{frame}{FORMATS[form]}" in done.stderr
    assert "Traceback" not in done.stdout + done.stderr


@pytest.mark.skipif(sys.platform == "win32", reason="no limit on the size of files")
def test_with_room_enough_the_same_command_succeeds(blend_file: Path, tmp_path: Path) -> None:
    for form in FORMATS:
        done = render_on_full_disk(blend_file, tmp_path / form, tmp_path, form, 1 << 24)
        assert done.returncode == 0, done.stdout + done.stderr


def test_a_picture_that_cannot_be_saved_is_kept_elsewhere(
    blend_file: Path, tmp_path: Path, monkeypatch: Any, capsys: Any
) -> None:
    FakeEngine(monkeypatch)
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    (tmp_path / "file").write_text("no folder")
    assert run_here(monkeypatch, str(blend_file), "-F", "OPEN_EXR", "-o", str(tmp_path / "file" / "x_"), "-f", "1") == 1
    (kept,) = tmp_path.glob("neuralguide_*_x_0001.exr")
    assert str(kept) in capsys.readouterr().err
    with OpenEXR.File(str(kept)) as file:
        assert file.channels()["RGBA"].pixels[0, 7, 0] == 7


def test_a_read_only_folder_is_named(blend_file: Path, tmp_path: Path, monkeypatch: Any, capsys: Any) -> None:
    FakeEngine(monkeypatch)
    folder = tmp_path / "locked"
    folder.mkdir(mode=0o555)
    if os.geteuid() == 0:
        # Nothing is read-only for root but what the system has no files for.
        folder = Path("/proc/self")
    assert run_here(monkeypatch, str(blend_file), "-o", str(folder / "x_"), "-f", "1") == 1
    assert str(folder) in capsys.readouterr().err


@pytest.mark.parametrize(("name", "code"), [("SIGINT", 130), ("SIGTERM", 143), ("SIGHUP", 129), ("SIGXCPU", 152)])
def test_an_interrupt_keeps_the_frame_and_stops(
    blend_file: Path, tmp_path: Path, monkeypatch: Any, name: str, code: int
) -> None:
    fake = FakeEngine(monkeypatch)
    fake.during_render = lambda _fake: os.kill(os.getpid(), getattr(signal, name))
    before = signal.getsignal(getattr(signal, name))
    assert run_here(monkeypatch, str(blend_file), "-o", "//x_", "-a") == code
    assert names(tmp_path) == ["x_0003.exr"]
    assert signal.getsignal(getattr(signal, name)) == before


def test_a_render_that_is_to_outlive_its_terminal_does(blend_file: Path, tmp_path: Path, monkeypatch: Any) -> None:
    """By nohup, which has the signal ignored."""
    fake = FakeEngine(monkeypatch)
    fake.during_render = lambda _fake: os.kill(os.getpid(), signal.SIGHUP)
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        assert run_here(monkeypatch, str(blend_file), "-o", "//x_", "-f", "1,2") == 0
    finally:
        signal.signal(signal.SIGHUP, before)
    assert names(tmp_path) == ["x_0001.exr", "x_0002.exr"]


@pytest.mark.parametrize("where", ["export", "load"])
def test_an_interrupt_before_there_is_a_picture_leaves_no_file(
    blend_file: Path, tmp_path: Path, monkeypatch: Any, capfd: Any, where: str
) -> None:
    """Blender crashed where it was to save a picture that had never been begun."""
    FakeEngine(monkeypatch).interrupt_at(where, lambda: os.kill(os.getpid(), signal.SIGTERM))
    for resume in ([], ["--resume"]):
        assert run_here(monkeypatch, str(blend_file), "-E", "NEURALGUIDE", "-o", "//x_", *resume, "-f", "1,2") == 143
        assert names(tmp_path) == []
        out, err = capfd.readouterr()
        assert "frame 1 was interrupted before there was a picture" in out and "failed" not in err


def test_help_and_unknown_options_need_no_blender() -> None:
    shown = command("--help")
    assert shown.returncode == 0
    assert "-f, --render-frame" in shown.stdout
    refused = command("-b", "--nonsense")
    assert refused.returncode == 2
    assert "unknown option '--nonsense'" in refused.stderr
    assert "Traceback" not in refused.stderr


def test_cycles_renders_too(blend_file: Path, tmp_path: Path) -> None:
    done = command(str(blend_file), "-E", "CYCLES", "-t", "1", "-o", "//c_", "-F", "PNG", "-f", "2", "--", "-ignored")
    assert done.returncode == 0, done.stderr
    assert names(tmp_path) == ["c_0002.png"]
