# SPDX-License-Identifier: GPL-3.0-or-later
"""Locks that go with their process, and files that are held while they are replaced."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from engine.processes.file_locks import FileHold
from engine.runtime.whole_files import remove_parts, write_whole

pytestmark = pytest.mark.skipif(os.name != "posix", reason="locks")
ROOT = Path(__file__).resolve().parents[3]
#: Holds a file until it is killed.
HOLDER = """
import sys, time
from pathlib import Path
from engine.processes.file_locks import FileHold
hold = FileHold()
print(hold.take(Path(sys.argv[1])), flush=True)
time.sleep(900)
"""


def test_a_file_is_held_until_its_process_ends(tmp_path: Path) -> None:
    path, hold = tmp_path / "x", FileHold()
    assert hold.take(path) and not hold.is_held, "there is nothing to hold"
    path.touch()
    with subprocess.Popen([sys.executable, "-c", HOLDER, path], cwd=ROOT, stdout=subprocess.PIPE, text=True) as other:
        assert other.stdout is not None and other.stdout.readline() == "True\n"
        assert not hold.take(path)
        other.kill()
    assert hold.take(path) and hold.is_held
    hold.release()


def test_a_hold_stays_when_the_file_is_replaced(tmp_path: Path) -> None:
    path, holds, other = tmp_path / "x", list[FileHold](), FileHold()
    write_whole(path, lambda file: holds.append(FileHold.of_open(file.fileno())))
    assert not other.take(path)
    write_whole(path, lambda file: holds.append(FileHold.of_open(file.fileno())))
    holds[0].release()
    assert not other.take(path), "the new one is held"
    holds[1].release()
    assert other.take(path)
    other.release()


def test_what_is_being_written_stays_and_what_was_left_goes(tmp_path: Path) -> None:
    path = tmp_path / "x"
    left = tmp_path / ".x.0123456789abcdef.part"
    left.touch()

    def write(file):  # type: ignore[no-untyped-def]
        hold = FileHold.of_open(file.fileno())
        remove_parts(path)
        file.write(b"all of it")
        hold.release()

    write_whole(path, write)
    assert path.read_bytes() == b"all of it" and [item.name for item in tmp_path.iterdir()] == ["x"]
