# SPDX-License-Identifier: GPL-3.0-or-later
"""--resume: what counts as rendered, and what happens where several processes render frames between them."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from addon.frame_files import FrameClaim, is_finished
from tests.helpers.command_line import names, run_here
from tests.helpers.fake_engine import FakeEngine

ROOT = Path(__file__).resolve().parents[2]
#: By Blender's name: what files end with.
SUFFIXES = {
    "PNG": "png", "JPEG": "jpg", "OPEN_EXR": "exr", "OPEN_EXR_MULTILAYER": "exr", "TIFF": "tif", "WEBP": "webp",
    "TARGA": "tga", "TARGA_RAW": "tga", "BMP": "bmp", "DPX": "dpx", "CINEON": "cin",
}  # fmt: skip
posix = pytest.mark.skipif(os.name != "posix", reason="locks and signals")

#: Claims a file, says so, and keeps it until it is killed.
HOLD = """
import sys
sys.path.insert(0, {root!r})
from pathlib import Path
from addon.frame_files import FrameClaim
claim = FrameClaim([Path(sys.argv[1])], makes_placeholders=True)
assert claim.take()
print("claimed", flush=True)
sys.stdin.read()
"""


def held_elsewhere(path: Path) -> subprocess.Popen[str]:
    """Another process that renders a frame."""
    other = subprocess.Popen(
        [sys.executable, "-c", HOLD.format(root=str(ROOT)), str(path)], stdin=subprocess.PIPE, stdout=subprocess.PIPE,
        text=True,
    )  # fmt: skip
    # Blender says things of its own before.
    assert other.stdout is not None and "claimed\n" in iter(other.stdout.readline, "")
    return other


@pytest.mark.parametrize("form", SUFFIXES)
def test_a_part_of_a_file_is_no_frame(blend_file: Path, tmp_path: Path, monkeypatch: Any, form: str) -> None:
    """A process may be killed while it writes."""
    FakeEngine(monkeypatch)
    assert run_here(monkeypatch, str(blend_file), "-E", "NEURALGUIDE", "-F", form, "-o", "//x_", "-f", "1") == 0
    path = tmp_path / f"x_0001.{SUFFIXES[form]}"
    whole = path.read_bytes()
    assert is_finished(path)
    for size in (0, 1, 5, 60, len(whole) // 2, len(whole) - 1):
        path.write_bytes(whole[:size])
        assert not is_finished(path), size
    assert not is_finished(tmp_path / "none.png")


@pytest.mark.parametrize("left_behind", [b"", b"\x89PNG", b"\x89PNG\r\n\x1a\n" + bytes(500)])
@pytest.mark.parametrize("switches", [["--resume"], []])
def test_what_a_killed_process_has_left_is_rendered_anew(
    blend_file: Path, blender: Any, tmp_path: Path, monkeypatch: Any, left_behind: bytes, switches: list[str],
) -> None:
    """With Blender's own switches in the file too."""
    if not switches:
        blender.context.scene.render.use_overwrite = False
        blender.context.scene.render.use_placeholder = True
        blender.ops.wm.save_mainfile()
    fake = FakeEngine(monkeypatch)
    (tmp_path / "x_0001.png").write_bytes(left_behind)
    line = [str(blend_file), "-E", "NEURALGUIDE", "-F", "PNG", "-o", "//x_", *switches, "-f", "1,2"]
    assert run_here(monkeypatch, *line) == 0
    assert [frame for _, frame in fake.exported] == [1, 2]
    assert names(tmp_path) == ["x_0001.png", "x_0002.png"] and is_finished(tmp_path / "x_0001.png")
    assert run_here(monkeypatch, *line) == 0
    assert [frame for _, frame in fake.exported] == [1, 2]
    assert not blender.context.scene.render.use_overwrite


@pytest.mark.parametrize("form", ["PNG", "JPEG", "OPEN_EXR", "OPEN_EXR_MULTILAYER"])
def test_a_frame_that_was_interrupted_is_rendered_to_its_end(
    blend_file: Path, tmp_path: Path, monkeypatch: Any, form: str
) -> None:
    fake = FakeEngine(monkeypatch)
    line = [str(blend_file), "-E", "NEURALGUIDE", "-F", form, "-o", "//x_", "--resume", "-f", "1"]
    fake.during_render = lambda _fake: os.kill(os.getpid(), signal.SIGTERM)
    assert run_here(monkeypatch, *line) == 143
    assert names(tmp_path) == [f"x_0001.{SUFFIXES[form]}"]
    fake.during_render = lambda _fake: None
    for _ in range(2):
        assert run_here(monkeypatch, *line) == 0
        assert len(fake.exported) == 2


@posix
def test_a_frame_that_another_process_renders_is_left_to_it(
    blend_file: Path, tmp_path: Path, monkeypatch: Any, capfd: Any
) -> None:
    fake = FakeEngine(monkeypatch)
    other = held_elsewhere(tmp_path / "x_0001.exr")
    line = [str(blend_file), "-E", "NEURALGUIDE", "-o", "//x_", "--resume", "-f", "1,2"]
    assert run_here(monkeypatch, *line) == 0
    assert [frame for _, frame in fake.exported] == [2]
    assert "frame 1 is left to another process" in capfd.readouterr().out
    assert (tmp_path / "x_0001.exr").stat().st_size == 0
    other.kill()
    other.communicate()
    assert run_here(monkeypatch, *line) == 0
    assert [frame for _, frame in fake.exported] == [2, 1]
    assert names(tmp_path) == ["x_0001.exr", "x_0002.exr"]


@posix
def test_a_file_that_grows_stays_claimed(tmp_path: Path) -> None:
    """Blender opens, writes and closes it while it is claimed, and it is looked at."""
    path = tmp_path / "folder" / "x.png"
    claim = FrameClaim([path], makes_placeholders=True)
    assert claim.take()
    path.write_bytes(b"\x89PNG and more")
    assert not is_finished(path)
    seen = "import sys; sys.path.insert(0, sys.argv[2]); from pathlib import Path; from addon.frame_files import *\n"
    seen += "sys.exit(7 if FrameClaim([Path(sys.argv[1])], makes_placeholders=False).take() else 3)"
    look = [sys.executable, "-c", seen, str(path), str(ROOT)]
    assert subprocess.run(look).returncode == 3
    claim.release()
    assert path.read_bytes() == b"\x89PNG and more"
    assert subprocess.run(look).returncode == 7


def test_without_placeholders_there_is_none(
    blend_file: Path, blender: Any, tmp_path: Path, monkeypatch: Any
) -> None:
    blender.context.scene.render.use_overwrite = False
    blender.context.scene.render.use_placeholder = False
    blender.ops.wm.save_mainfile()
    fake = FakeEngine(monkeypatch)
    seen: list[bool] = []
    fake.during_render = lambda _fake: seen.append((tmp_path / "x_0001.exr").exists())
    assert run_here(monkeypatch, str(blend_file), "-E", "NEURALGUIDE", "-o", "//x_", "-f", "1") == 0
    assert seen == [False] and is_finished(tmp_path / "x_0001.exr")


def test_a_folder_that_cannot_be_made_is_said_before_rendering(
    blend_file: Path, tmp_path: Path, monkeypatch: Any, capsys: Any
) -> None:
    fake = FakeEngine(monkeypatch)
    (tmp_path / "file").write_text("no folder")
    output = str(tmp_path / "file" / "x_")
    assert run_here(monkeypatch, str(blend_file), "-E", "NEURALGUIDE", "-o", output, "--resume", "-f", "1") == 1
    assert "cannot be written" in capsys.readouterr().err and not fake.exported


def test_both_eyes_of_stereo_are_files_of_a_frame(
    blend_file: Path, blender: Any, tmp_path: Path, monkeypatch: Any
) -> None:
    blender.context.scene.render.use_multiview = True
    blender.ops.wm.save_mainfile()
    fake = FakeEngine(monkeypatch)
    line = [str(blend_file), "-E", "NEURALGUIDE", "-F", "PNG", "-o", "//x_", "--resume", "-f", "1"]
    assert run_here(monkeypatch, *line) == 0
    files = [name for name in names(tmp_path) if name.endswith(".png")]
    assert files == ["x_0001_L.png", "x_0001_R.png"]
    exported = len(fake.exported)
    (tmp_path / files[1]).write_bytes(b"")
    assert run_here(monkeypatch, *line) == 0
    assert len(fake.exported) == 2 * exported and all(is_finished(tmp_path / name) for name in files)
