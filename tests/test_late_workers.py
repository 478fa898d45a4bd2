# SPDX-License-Identifier: GPL-3.0-or-later
"""Half of the workers wait for cores, and what would be theirs is run by the others."""

from __future__ import annotations

import os
import subprocess
import sys
from collections import Counter
from pathlib import Path

from tests.helpers.late_workers import VARIABLE
from tests.helpers.waiting import wait_until

ROOT = Path(__file__).resolve().parents[1]
COUNT = 40

SOME = f"""
import os, time
import pytest

@pytest.mark.parametrize("number", range({COUNT}))
def test_some(number):
    time.sleep(0.05)
    with open("log", "a") as file:
        print(os.environ["PYTEST_XDIST_WORKER"], file=file)
"""


def test_late_workers_begin_when_cores_are_free_and_no_test_is_lost(tmp_path: Path) -> None:
    (tmp_path / "test_some.py").write_text(SOME)
    log, free = tmp_path / "log", tmp_path / "free"
    log.touch()
    command = [sys.executable, "-m", "pytest", "-q", "-n", "2", "--dist", "loadscope", "-p", "tests.conftest"]
    command += ["--rootdir", str(tmp_path), "-p", "no:cacheprovider", "-c", os.devnull, str(tmp_path)]
    environment = {**os.environ, "PYTHONPATH": str(ROOT), VARIABLE: str(free)}
    running = subprocess.Popen(command, cwd=tmp_path, env=environment, stdout=subprocess.PIPE, text=True)
    # More than was to be its own at first.
    wait_until(lambda: len(log.read_text().split()) > COUNT // 2 or running.poll() is not None)
    early = log.read_text().split()
    free.touch()
    said, _ = running.communicate()
    assert set(early) == {"gw0"} and len(early) > COUNT // 2, said
    assert f"{COUNT} passed" in said and running.returncode == 0
    ran = Counter(log.read_text().split())
    assert ran["gw1"] > 0 and ran.total() == COUNT
