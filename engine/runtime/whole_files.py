# SPDX-License-Identifier: GPL-3.0-or-later
"""Writing files that are there whole, or as they were before: whoever ends the process, or the power."""

from __future__ import annotations

import contextlib
import os
import secrets
import time
from collections.abc import Callable
from pathlib import Path
from typing import IO

from engine.processes.file_locks import FileHold

#: Another program may hold the target open for a moment, on Windows [s].
_PATIENCE = 2.0
_NAP = 0.05
_PART = ".part"


def write_whole(path: Path, write: Callable[[IO[bytes]], None]) -> None:
    """Write a file beside its target, and put it in its place once all of it is on the disk.

    Parameters
    ----------
    path : Path
    write : callable (file) -> None
        Writes all that it is to hold to a file open for bytes, which can be sought in.

    Raises
    ------
    OSError
        If it cannot be written; what was there before is still there.
    """
    beside = path.with_name(f".{path.name}.{secrets.token_hex(8)}{_PART}")
    try:
        with beside.open("xb") as file:
            write(file)
            file.flush()
            os.fsync(file.fileno())
        _replace(beside, path)
        _keep_name(path.parent)
    finally:
        # A file system that is read-only refuses this too, whether or not there is such a file.
        with contextlib.suppress(OSError):
            beside.unlink(missing_ok=True)


def remove_parts(path: Path) -> None:
    """Remove what processes that were killed have left beside a file that `write_whole` writes.

    What another process is writing stays, if that holds it (`engine.processes.file_locks.FileHold.of_open`).
    """
    with contextlib.suppress(OSError):
        for part in path.parent.iterdir():
            if part.name.startswith(f".{path.name}.") and part.name.endswith(_PART):
                hold = FileHold()
                if hold.take(part):
                    with contextlib.suppress(OSError):
                        part.unlink()
                hold.release()


def _replace(source: Path, target: Path) -> None:
    """Put a file in its place."""
    deadline = time.monotonic() + _PATIENCE
    while True:
        try:
            os.replace(source, target)
            return
        except PermissionError:
            if os.name != "nt" or time.monotonic() >= deadline:
                raise
            time.sleep(_NAP)


def _keep_name(folder: Path) -> None:
    """Have the folder's new entry on the disk as well, where the system knows of such a thing."""
    if os.name == "nt":
        return
    # Some file systems refuse it: the file itself is there.
    with contextlib.suppress(OSError):
        descriptor = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)
