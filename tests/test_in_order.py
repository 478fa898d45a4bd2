# SPDX-License-Identifier: GPL-3.0-or-later
"""Tests begin in their order whatever the number of workers, and what comes last does so on each of them."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

from tests.helpers.enough_time import VARIABLE
from tests.helpers.in_order import units

ROOT = Path(__file__).resolve().parents[1]

SOME = """
import time
import pytest

@pytest.mark.parametrize("number", [pytest.param(n, marks=pytest.mark.one_of_many) for n in range(20)])
def test_alike(number):
    note("alike")

@pytest.mark.parametrize("number", range(20))
def test_other(number):
    note("other")

def note(what):
    time.sleep(0.02)
    with open("log", "a") as file:
        print(what, file=file)
"""


def test_a_file_s_tests_are_taken_four_at_once() -> None:
    first, second = [f"a.py::test[{n}]" for n in range(6)], ["b.py::test", "b.py::test_two"]
    unit_of = units(first + second)
    assert [unit_of[test] for test in first] == [first[0]] * 4 + [first[4]] * 2
    assert [unit_of[test] for test in second] == [second[0]] * 2


def test_like_cases_come_last_on_all_workers(tmp_path: Path) -> None:
    (tmp_path / "test_some.py").write_text(SOME)
    command = [sys.executable, "-m", "pytest", "-q", "-n", "3", "--dist", "loadscope", "-p", "tests.conftest"]
    command += ["--rootdir", str(tmp_path), "-p", "no:cacheprovider", "-c", os.devnull, str(tmp_path)]
    # It is about the order: the clock of a run in CI that has this test in it leaves nothing out.
    environment = {**os.environ, "PYTHONPATH": str(ROOT)} | {VARIABLE: ""}
    said = subprocess.run(command, cwd=tmp_path, env=environment, stdout=subprocess.PIPE, text=True, check=False).stdout
    assert "40 passed" in said
    ran = (tmp_path / "log").read_text().split()
    # Whoever has taken some of the others runs them while the rest go on.
    assert "alike" not in ran[:12] and "other" not in ran[-12:], ran
