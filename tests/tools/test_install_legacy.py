# SPDX-License-Identifier: GPL-3.0-or-later
"""Installing into Blenders that take no zip: by any Python, for theirs, and in words where that cannot be."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from tools.blender_ranges import pinned
from tools.install_legacy import DENOISER, REQUIREMENTS, install

ROOT = Path(__file__).resolve().parents[2]


def script(path: Path, text: str) -> str:
    path.write_text(f"#!/bin/sh\n{text}")
    path.chmod(0o755)
    return str(path)


def fake_blender(folder: Path, python: str) -> str:
    """A Blender with that version of Python."""
    return script(folder / "blender", f"echo SCRIPTS={folder}/scripts; echo PYTHON={python}; echo ENABLED=True\n")


@pytest.fixture
def pip_calls(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """What pip was asked for, by a Python that does nothing."""
    monkeypatch.setattr(sys, "executable", script(tmp_path / "python", f'echo "$@" >> {tmp_path}/calls\n'))
    return tmp_path / "calls"


@pytest.mark.parametrize("python", ["3.11", "3.13"])
def test_packages_are_those_of_blenders_python(tmp_path: Path, pip_calls: Path, python: str) -> None:
    folder = install(fake_blender(tmp_path, python))
    assert folder == tmp_path / "scripts" / "addons" / "neuralguide"
    assert (folder / "__init__.py").is_file() and (folder / "engine").is_dir()
    asked = [line for line in pip_calls.read_text().splitlines() if " install " in line]
    assert all(f"--python-version {python} " in line for line in asked)
    # pip runs in another Python than Blender, for which numpy of 3.13 is too new.
    assert all(" --ignore-requires-python " in line for line in asked)
    assert all(f"--target {tmp_path}/scripts/modules" in line for line in asked)
    names = [name for line in asked for name in line.split() if "==" in name]
    assert names == [*pinned(python, REQUIREMENTS), DENOISER]
    assert {name.partition("==")[0] for name in names} == {*REQUIREMENTS, "pyoidn"}


def test_a_python_without_packages_is_named(tmp_path: Path, pip_calls: Path) -> None:
    with pytest.raises(SystemExit, match=r"runs Python 3\.12, and NeuralGuide has packages for 3\.11 and 3\.13 only"):
        install(fake_blender(tmp_path, "3.12"))
    assert not pip_calls.exists() and not (tmp_path / "scripts").exists()


def test_what_is_no_blender_is_named(tmp_path: Path) -> None:
    with pytest.raises(SystemExit, match="blender does not run: No such file"):
        install(str(tmp_path / "blender"))


def test_packages_that_pip_does_not_get_are_no_traceback(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    text = 'case "$*" in *--version*) exit 0;; esac; echo "ERROR: No matching distribution" >&2; exit 1\n'
    monkeypatch.setattr(sys, "executable", script(tmp_path / "python", text))
    with pytest.raises(SystemExit, match=r"(?s)packages for Python 3\.13:.*ERROR: No matching distribution"):
        install(fake_blender(tmp_path, "3.13"))
    assert not (tmp_path / "scripts" / "addons").exists()


def test_without_the_denoiser_it_is_installed_all_the_same(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    text = 'case "$*" in *pyoidn*) echo "ERROR: no" >&2; exit 1;; esac\n'
    monkeypatch.setattr(sys, "executable", script(tmp_path / "python", text))
    assert install(fake_blender(tmp_path, "3.13")).is_dir()
    assert "nothing is denoised" in capsys.readouterr().err


def test_the_command_needs_no_package() -> None:
    """Not even llvmlite, which the tool that builds zips needs."""
    command = [sys.executable, "-S", "tools/install_legacy.py", "--help"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0 and "--without-denoiser" in done.stdout, done.stderr
