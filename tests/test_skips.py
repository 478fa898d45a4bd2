# SPDX-License-Identifier: GPL-3.0-or-later
"""What CI makes of tests that are skipped."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from pathlib import Path

import pytest

from tests.helpers.allowed_skips import is_allowed
from tests.helpers.enough_time import REASON, VARIABLE

ROOT = Path(__file__).resolve().parents[1]

OF_ALL_KINDS = """
import pytest

@pytest.mark.skipif(True, reason="no such program here")
def test_by_a_mark(): ...

def test_inside():
    pytest.skip("there is no such thing")

@pytest.mark.skipif(True, reason="Blender 5.2 has it")
def test_of_another_blender(): ...

@pytest.mark.xfail(reason="not yet")
def test_that_is_to_fail():
    raise AssertionError

def test_that_passes(): ...
"""
OF_A_PACKAGE = "import pytest\npytest.importorskip('no_such_package')\ndef test_of_it(): ...\n"


def outcome(folder: Path, **environment: str) -> str:
    """The last line of what pytest says."""
    command = [sys.executable, "-m", "pytest", "-q", "-n", "0", "-p", "tests.conftest", "--rootdir", str(folder)]
    command += ["-p", "no:cacheprovider", "-c", os.devnull, str(folder)]
    inherited = {name: value for name, value in os.environ.items() if name != "CI"}
    done = subprocess.run(command, cwd=ROOT, env={**inherited, **environment}, capture_output=True, text=True)
    return done.stdout.strip().splitlines()[-1]


@pytest.mark.parametrize(("source", "here", "in_ci"), [
    (OF_ALL_KINDS, "1 passed, 3 skipped, 1 xfailed", "1 failed, 1 passed, 1 skipped, 1 xfailed, 1 error"),
    (OF_A_PACKAGE, "1 skipped", "1 error"),
])  # fmt: skip
def test_in_ci_a_skip_is_a_failure_but_for_another_blender(tmp_path: Path, source: str, here: str, in_ci: str) -> None:
    (tmp_path / "test_some.py").write_text(source)
    assert outcome(tmp_path).startswith(here)
    assert outcome(tmp_path, CI="true").startswith(in_ci)


OF_MANY = """
import pytest

@pytest.mark.one_of_many
@pytest.mark.parametrize("number", range(3))
def test_like_others(number): ...

def test_of_its_own():
    print("first")
"""


def test_when_time_is_nearly_over_ci_leaves_out_some_of_many_like_cases(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv(VARIABLE, raising=False)
    (tmp_path / "test_some.py").write_text(OF_MANY)
    (tmp_path / "pytest.ini").write_text("[pytest]\nmarkers = one_of_many: like others")
    now = time.time()
    assert outcome(tmp_path, CI="true").startswith("4 passed")
    assert outcome(tmp_path, CI="true", **{VARIABLE: str(now + 600.0)}).startswith("4 passed")
    assert outcome(tmp_path, CI="true", **{VARIABLE: str(now - 1.0)}).startswith("1 passed, 3 skipped")
    # Nobody else may give that reason.
    assert not is_allowed(REASON)


@pytest.mark.parametrize("reason", ["Skipped: Blender 5.2 has it", "this Blender brings no module for OpenVDB"])
def test_reasons_of_other_blenders(reason: str) -> None:
    assert is_allowed(reason)


@pytest.mark.parametrize("reason", [
    "Skipped: could not import 'onnx': No module named 'onnx'", "no blender binary; .ci/run installs Debian's",
    "signals", "too small to be found",
])  # fmt: skip
def test_reasons_that_are_none(reason: str) -> None:
    assert not is_allowed(reason)


def test_reasons_of_other_pythons(monkeypatch: pytest.MonkeyPatch) -> None:
    reason = "this trains networks, and torch is not installed"
    for version, is_other in (((3, 11, 9), False), ((3, 13, 1), True)):
        monkeypatch.setattr(sys, "version_info", version)
        assert is_allowed(reason) == is_other
    missing = "Python 3.13 is needed: found none that runs"
    monkeypatch.delenv("NEURALGUIDE_WITHOUT_PYTHON_313", raising=False)
    assert not is_allowed(missing)
    monkeypatch.setenv("NEURALGUIDE_WITHOUT_PYTHON_313", "1")
    assert is_allowed(missing)
