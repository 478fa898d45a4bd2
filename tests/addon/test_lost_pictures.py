# SPDX-License-Identifier: GPL-3.0-or-later
"""What fails when a picture is there must not cost it, nor the frames after it."""

from __future__ import annotations

import errno
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import OpenEXR
import pytest

from addon.console import complain, say
from addon.progress import TerminalBar
from tests.helpers.command_line import names, run_here
from tests.helpers.fake_engine import FakeEngine
from tests.helpers.frozen_folders import freeze

ROOT = Path(__file__).resolve().parents[2]
#: Runs the command line with a session that renders at once.
FAKE_COMMAND = """
import sys
sys.path.insert(0, {root!r})
from pytest import MonkeyPatch
from tests.helpers.fake_engine import FakeEngine
FakeEngine(MonkeyPatch())
from addon.__main__ import main
sys.exit(main(sys.argv[1:]))
"""


def pixels(path: Path) -> Any:
    with OpenEXR.File(str(path)) as file:
        return file.channels()["RGBA"].pixels


def render(monkeypatch: Any, blend_file: Path, *more: str) -> int:
    return run_here(monkeypatch, str(blend_file), "-E", "NEURALGUIDE", "-F", "OPEN_EXR", "-o", "//x_", *more)


@pytest.mark.parametrize("stream", ["stdout", "stderr", "both"])
def test_whoever_reads_the_output_may_go_away(blend_file: Path, tmp_path: Path, stream: str) -> None:
    """As the end of `| head` does, or a closed window: all frames are rendered."""
    reader, writer = os.pipe()
    os.close(reader)
    streams = {name: writer if stream in (name, "both") else subprocess.DEVNULL for name in ("stdout", "stderr")}
    code = FAKE_COMMAND.format(root=str(ROOT))
    line = ["-b", str(blend_file), "-E", "NEURALGUIDE", "-o", "//x_", "-f", "1,2,2", "--resume", "-f", "1"]
    done = subprocess.run([sys.executable, "-c", code, *line], **streams, timeout=300)  # type: ignore[call-overload]
    os.close(writer)
    assert done.returncode == 0
    assert names(tmp_path) == ["x_0001.exr", "x_0002.exr"]


def test_a_command_that_only_talks_may_lose_its_reader_too() -> None:
    reader, writer = os.pipe()
    os.close(reader)
    for line, code in ((["--help"], 0), (["--nonsense"], 2)):
        command = [sys.executable, "-m", "addon", *line]
        done = subprocess.run(command, stdout=writer, stderr=writer, cwd=ROOT, timeout=300)
        assert done.returncode == code
    os.close(writer)


class _Failing:
    """A stream whose disk is full."""

    def isatty(self) -> bool:
        return False

    def write(self, _text: str) -> int:
        raise OSError(errno.ENOSPC, "No space left on device")

    flush = write


@pytest.mark.parametrize("stream", ["full", "closed", "none"])
def test_words_that_cannot_be_said_are_left_unsaid(stream: str, monkeypatch: Any, tmp_path: Path) -> None:
    closed = (tmp_path / "log").open("w")
    closed.close()
    broken: Any = {"full": _Failing(), "closed": closed, "none": None}[stream]
    monkeypatch.setattr(sys, "stdout", broken)
    monkeypatch.setattr(sys, "stderr", broken)
    from addon import log

    say("left out")
    complain("left out")
    log.register()
    log.logger.warning("left out")
    bar = TerminalBar(line_interval=0.0)
    progress = SimpleNamespace(
        message="Rendering", remaining=1.0, sample=1, samples=2, elapsed=1.0, rays_per_second=1.0, noisy_share=None
    )
    bar.update("Frame 1", 0.5, progress)
    bar.close()


def test_a_field_on_a_read_only_file_system_costs_no_picture(
    blend_file: Path, tmp_path: Path, monkeypatch: Any, capfd: Any
) -> None:
    from tests.helpers.learned_fields import learned_field

    fake = FakeEngine(monkeypatch)
    fake.learned = learned_field()
    folder = tmp_path / "frozen"
    folder.mkdir()
    freeze(monkeypatch, folder)
    assert render(
        monkeypatch, blend_file, "--set", "guiding_method=VMM", "--set", "save_field=on", "--field",
        str(folder / "room.ngfield"), "-f", "1,2",
    ) == 0  # fmt: skip
    assert pixels(tmp_path / "x_0002.exr")[0, 7, 0] == 7
    assert "room.ngfield cannot be written (Read-only file system)" in capfd.readouterr().err


@pytest.mark.parametrize("step", ["log_figures", "stamp_figures", "stamp_mattes"])
def test_figures_that_cannot_be_told_cost_no_picture(
    blend_file: Path, tmp_path: Path, monkeypatch: Any, capfd: Any, step: str
) -> None:
    from addon import figures

    def fail(*_args: Any) -> None:
        raise ZeroDivisionError("figures")

    FakeEngine(monkeypatch)
    monkeypatch.setattr(figures, step, fail)
    assert render(monkeypatch, blend_file, "-f", "1") == 0
    assert pixels(tmp_path / "x_0001.exr")[0, 7, 0] == 7
    error = capfd.readouterr().err
    assert "failed: ZeroDivisionError: figures" in error and "Traceback" not in error


def test_a_field_that_fails_in_any_way_costs_no_picture(
    blend_file: Path, tmp_path: Path, monkeypatch: Any, capfd: Any
) -> None:
    from addon import learned_fields

    def fail(*_args: Any) -> None:
        raise MemoryError

    FakeEngine(monkeypatch)
    monkeypatch.setattr(learned_fields.FieldPlan, "take", fail)
    assert render(monkeypatch, blend_file, "-f", "1") == 0
    assert pixels(tmp_path / "x_0001.exr")[0, 7, 0] == 7
    assert "keeping what was learned failed" in capfd.readouterr().err


def test_a_pass_that_cannot_be_made_costs_no_picture(
    blend_file: Path, blender: Any, tmp_path: Path, monkeypatch: Any, capfd: Any
) -> None:
    from addon import passes

    def write(target: Any, image: Any, real: Any = passes.write_pass) -> None:
        if target.name == "Normal":
            raise MemoryError
        real(target, image)

    blender.context.view_layer.use_pass_normal = True
    blender.ops.wm.save_mainfile()
    FakeEngine(monkeypatch)
    monkeypatch.setattr(passes, "write_pass", write)
    assert render(monkeypatch, blend_file, "-f", "1") == 0
    assert pixels(tmp_path / "x_0001.exr")[0, 7, 0] == 7
    assert "making pass Normal failed" in capfd.readouterr().err


def test_what_was_rendered_before_a_failure_is_kept(
    blend_file: Path, tmp_path: Path, monkeypatch: Any, capsys: Any
) -> None:
    fake = FakeEngine(monkeypatch)
    fake.render_error = MemoryError()
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    assert render(monkeypatch, blend_file, "-f", "1") == 1
    (kept,) = tmp_path.glob("neuralguide_*_x_0001.exr")
    assert "out of memory while rendering" in (error := capsys.readouterr().err) and str(kept) in error
    assert pixels(kept)[0, 7, 0] == 7


def test_a_layer_that_fails_does_not_cost_those_before_it(
    blend_file: Path, blender: Any, tmp_path: Path, monkeypatch: Any, capsys: Any
) -> None:
    blender.context.scene.view_layers.new("Second")
    blender.ops.wm.save_mainfile()
    fake = FakeEngine(monkeypatch)

    def fail_later() -> None:
        if fake.exported:
            fake.export_error = ValueError("Cube: vertex 3 is NaN")

    fake.interrupt_at("export", fail_later)
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    assert render(monkeypatch, blend_file, "-f", "1") == 1
    (kept,) = tmp_path.glob("neuralguide_*_x_0001.exr")
    assert str(kept) in capsys.readouterr().err
    assert pixels(kept)[0, 7, 0] == 7


def test_no_log_and_no_folder_for_temporary_files_cost_no_picture(
    blend_file: Path, tmp_path: Path, monkeypatch: Any, capfd: Any
) -> None:
    def nowhere() -> str:
        raise FileNotFoundError(errno.ENOENT, "No usable temporary directory found")

    fake = FakeEngine(monkeypatch)
    # The teardown of tests needs a folder for temporary files itself.
    with monkeypatch.context() as patch:
        patch.setattr(tempfile, "gettempdir", nowhere)
        # Beside it the log would lie.
        patch.setattr("engine.runtime.kernel_cache.cache_root", lambda: blend_file / "kernels")
        fake.render_error = KeyError("mesh 17")
        assert render(monkeypatch, blend_file, "-f", "1") == 1
        assert "mesh 17" in capfd.readouterr().err
        fake.render_error = None
        assert render(monkeypatch, blend_file, "-f", "2") == 0
    assert pixels(tmp_path / "x_0002.exr")[0, 7, 0] == 7
