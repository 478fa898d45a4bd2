# SPDX-License-Identifier: GPL-3.0-or-later
"""What packages and environments are made by: which Python runs here, which Blenders a zip is for."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from tools import build_extension
from tools.blender_ranges import RANGES, ROOT, lock_file, pinned, range_of
from tools.build_extension import WHEELS


@pytest.mark.parametrize(
    ("version", "python"),
    [("4.2", "3.11"), ("4.2.0", "3.11"), ("4.5.3", "3.11"), ("5.0.1", "3.11"), ("5.1", "3.13"), ("5.2.3", "3.13")],
)
def test_a_blender_belongs_to_the_range_with_its_python(version: str, python: str) -> None:
    assert range_of(version).python == python
    assert sum(candidate.holds(version) for candidate in RANGES) == 1


@pytest.mark.parametrize("version", ["4.1.1", "3.4", "", "5.x", "latest"])
def test_other_blenders_have_no_range(version: str) -> None:
    with pytest.raises(ValueError, match="Blender"):
        range_of(version)


@pytest.mark.parametrize("blenders", RANGES, ids=lambda blenders: blenders.name)
def test_lock_files_pin_what_the_extension_brings(blenders) -> None:
    lines = lock_file(blenders.python).read_text(encoding="utf-8").splitlines()
    assert all("==" in line for line in lines if not line.startswith("#"))
    assert [line.partition("==")[0] for line in pinned(blenders.python, WHEELS)] == sorted(WHEELS)


def test_both_lock_files_bring_the_same_wheels() -> None:
    """What is in the zips, and what checks this code, is the same for all Blenders."""
    same = {*WHEELS, "mypy", "pytest", "ruff"}
    assert pinned("3.11", same) == pinned("3.13", same)


def test_an_unknown_blender_is_a_sentence(capsys: pytest.CaptureFixture, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "argv", ["build_extension.py", "--blender", "4.1"])
    with pytest.raises(SystemExit):
        build_extension.main()
    assert "there is no extension for Blender 4.1" in capsys.readouterr().err


def a_python(path: Path, version: str = "", status: int = 0) -> Path:
    """A stand-in for Python; with a version it says that to whoever asks."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(f"#!/bin/sh\necho {version}\nexit {status}\n")
    path.chmod(0o755)
    return path


def run_tool(name: str, *arguments: str, path: list[Path], **environment: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [str(ROOT / "tools" / name), *arguments],
        env={"PATH": os.pathsep.join([*map(str, path), os.defpath]), "HOME": "/nonexistent", **environment},
        capture_output=True,
        text=True,
    )


def test_a_python_is_run_before_it_is_taken(tmp_path: Path) -> None:
    broken = a_python(tmp_path / "shims" / "python9.9", status=127)
    good = a_python(tmp_path / "bin" / "python9.9")
    found = run_tool("find_python.sh", "9.9", path=[broken.parent, good.parent])
    assert (found.returncode, found.stdout.strip()) == (0, str(good))


def test_the_first_version_that_runs_is_taken(tmp_path: Path) -> None:
    newer, older = a_python(tmp_path / "python9.9"), a_python(tmp_path / "python9.8")
    found = run_tool("find_python.sh", "9.8", "9.9", path=[tmp_path])
    assert found.stdout.strip() == str(older)
    older.unlink()
    found = run_tool("find_python.sh", "9.8", "9.9", path=[tmp_path])
    assert found.stdout.strip() == str(newer)


def test_pythons_that_pyenv_keeps_are_found(tmp_path: Path) -> None:
    good = a_python(tmp_path / "versions" / "9.9.1" / "bin" / "python")
    found = run_tool("find_python.sh", "9.9", path=[], PYENV_ROOT=str(tmp_path))
    assert found.stdout.strip() == str(good)


def test_no_python_is_one_line() -> None:
    found = run_tool("find_python.sh", "9.8", "9.9", path=[])
    assert (found.returncode, found.stdout) == (1, "")
    assert found.stderr.startswith("Python 9.8 or 9.9 is needed") and found.stderr.count("\n") == 1


def test_an_environment_of_another_python_is_refused(tmp_path: Path) -> None:
    other = a_python(tmp_path / "python", version="9.9")
    made = run_tool("make_environment.sh", str(tmp_path / "venv"), "3.11", "3.13", path=[], BASE_PYTHON=str(other))
    assert made.returncode == 1
    assert made.stderr == f"{other} is Python 9.9, and NeuralGuide needs here: 3.11 3.13\n"
    assert not (tmp_path / "venv").exists()


@pytest.mark.skipif(shutil.which("make") is None, reason="no make")
def test_make_knows_the_environment_of_each_python() -> None:
    for blenders in RANGES:
        target = f".venv-{blenders.python}/installed"
        planned = subprocess.run(
            ["make", "--dry-run", "--always-make", target], cwd=ROOT, capture_output=True, text=True, check=True
        )
        assert f"tools/make_environment.sh .venv-{blenders.python} {blenders.python}" in planned.stdout
