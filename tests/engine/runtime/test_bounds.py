# SPDX-License-Identifier: GPL-3.0-or-later
"""Kernels that look at their indices say which are outside, and go on; others are not slowed down by it."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[3]

#: Reads and writes one element too far, or too early, in each kind of array that kernels know.
TOO_FAR = """
import numpy as np
from engine.kernels.local import LOCAL_COUNT, local_floats
from engine.runtime import bounds
from engine.runtime.bundle import Bundle
from engine.runtime.jit import kernel

class Fields(Bundle):
    values: np.ndarray

class Varying(Bundle):
    _dynamic = frozenset({"values"})
    values: np.ndarray

class Lanes(Bundle):
    _rows = True
    values: np.ndarray

@kernel
def read_field(fields, row, column):
    return fields.values[row, column]

@kernel
def write_varying(varying, row, column):
    varying.values[row, column] = 7.0

@kernel
def read_lane(lanes, row, column):
    return lanes.values[row, column]

@kernel
def read_room(place):
    room = local_floats()
    for k in range(LOCAL_COUNT):
        room[k] = np.float32(k + 1)
    return room[place]

@kernel
def read_array(values, row):
    return values[row]

values = np.arange(6, dtype=np.float32).reshape(2, 3)
fields, varying, lanes = Fields(values), Varying(values.copy()), Lanes(values)
assert read_field(fields, 1, 2) == read_lane(lanes, 1, 2) == 5.0 and read_room(7) == 8.0
write_varying(varying, 1, 2)
assert read_array(values[0], 2) == 2.0 and read_array(values[0], -1) == 2.0
assert bounds.found == [], bounds.found
assert read_field(fields, 2, 1) == 1.0 and read_field(fields, 2, 0) == 0.0
assert read_field(fields, -1, 3) == 0.0
write_varying(varying, 1, 3)
assert varying.values[1, 0] == 7.0
assert read_lane(lanes, 3, 1) == 1.0
assert read_room(8) == 1.0
try:
    read_array(values[0], 3)
except IndexError:
    print("raised")
print(*bounds.found, sep="\\n")
"""


def run(script: Path, cache: Path, **environment: str) -> subprocess.CompletedProcess[str]:
    """A script in a process with a kernel cache of its own."""
    set_here = {"PYTHONPATH": str(ROOT), "NEURALGUIDE_KERNEL_CACHE": str(cache), **environment}
    return subprocess.run(
        [sys.executable, str(script)], env={**os.environ, **set_here}, capture_output=True, text=True, check=False
    )


def test_what_lies_outside_is_said_once_for_each_place(tmp_path: Path) -> None:
    script = tmp_path / "too_far.py"
    script.write_text(TOO_FAR)
    for _from_the_cache in range(2):
        done = run(script, tmp_path / "cache", NEURALGUIDE_CHECK_BOUNDS="1")
        assert done.returncode == 0, done.stderr
        said = done.stdout.splitlines()
        assert said[0] == "raised"
        assert [line.partition(",")[0] for line in said[1:]] == [
            "read_field line 21", "read_field line 21", "write_varying line 25", "read_lane line 29",
            "read_room line 36", "read_array line 40",
        ]
        assert [line.rpartition("index ")[2] for line in said[1:]] == [
            "2 of 2", "3 of 3", "3 of 3", "3 of 2", "8 of 8", "3 of 3",
        ]
        assert done.stderr.splitlines() == [f"outside: {line}" for line in said[1:]]


def test_kernels_that_look_are_kept_beside_those_that_do_not(tmp_path: Path) -> None:
    """Neither finds the other's machine code."""
    script, cache = tmp_path / "within.py", tmp_path / "cache"
    script.write_text(TOO_FAR.partition("assert read_field(fields, 2, 1)")[0] + "print(read_array.stats.cache_hits)")
    hits = [run(script, cache, NEURALGUIDE_CHECK_BOUNDS=checks) for checks in ("0", "1", "0", "1")]
    assert ["({" in done.stdout for done in hits] == [False, False, True, True], [done.stderr for done in hits]


@pytest.mark.slow
def test_a_render_that_goes_on_from_another_reads_nothing_outside() -> None:
    """What is saved and what is begun anew are of the same regions: once a table was of one."""
    command = [sys.executable, "-m", "pytest", "-q", "-k", "starts_from_what_the_others_know and TABLE_RIS"]
    tests = str(ROOT / "tests" / "engine" / "guiding" / "saved" / "test_learned.py")
    # It is no worker of this run.
    environment = {name: value for name, value in os.environ.items() if not name.startswith("PYTEST_")}
    environment["NEURALGUIDE_CHECK_BOUNDS"] = "1"
    done = subprocess.run([*command, tests], cwd=ROOT, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0 and "1 passed" in done.stdout, done.stdout
