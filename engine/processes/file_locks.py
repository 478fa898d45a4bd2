# SPDX-License-Identifier: GPL-3.0-or-later
"""Locks on files, which the system frees when the process that has them ends, however it ends."""

from __future__ import annotations

import contextlib
import errno
import os
import struct
import sys
from pathlib import Path

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None  # type: ignore[assignment]

#: The byte that is locked: beyond what any file has, since some network file systems keep others from writing where a
#: lock is.
_LOCKED_BYTE = 1 << 40
#: What a lock is refused with that another process has.
_TAKEN = (errno.EACCES, errno.EAGAIN)


def lock(file: int) -> bool:
    """Lock a file until it is closed, by this process or by its end; False where another process has.

    Parameters
    ----------
    file : int
        Descriptor of a file that is open for writing.
    """
    if fcntl is None:
        return True
    try:
        if sys.platform == "linux":
            # The lock is this open file's: other kinds go when any file of the process at the same path is closed.
            request = struct.pack("hhqqi0q", fcntl.F_WRLCK, os.SEEK_SET, _LOCKED_BYTE, 1, 0)
            fcntl.fcntl(file, fcntl.F_OFD_SETLK, request)
        else:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        # Some file systems have no locks: there two processes may do the same, and nothing is left undone.
        return error.errno not in _TAKEN
    return True


class FileHold:
    """A lock on a file that others can ask about by its path. On Windows it holds nothing: an open file cannot be
    replaced there.
    """

    def __init__(self) -> None:
        self._file = -1

    @classmethod
    def of_open(cls, file: int) -> FileHold:
        """That of a file which is open for writing and nobody else knows of; it lasts beyond the file's closing."""
        hold = cls()
        if fcntl is not None:
            hold._file = os.dup(file)
            lock(hold._file)
        return hold

    @property
    def is_held(self) -> bool:
        """Whether there is a file that it holds."""
        return self._file >= 0

    def take(self, path: Path) -> bool:
        """Hold the file of a path, if there is one; False: another process holds it."""
        if fcntl is None or self.is_held:
            return True
        while True:
            try:
                file = os.open(path, os.O_RDWR | os.O_NONBLOCK)
            except OSError:
                # There is none, or none that can be written.
                return True
            if not lock(file):
                os.close(file)
                return False
            with contextlib.suppress(FileNotFoundError):
                if os.path.samestat(os.fstat(file), path.stat()):
                    self._file = file
                    return True
            # Whoever had it has replaced or removed it meanwhile.
            os.close(file)

    def release(self) -> None:
        """Let others have it."""
        if self.is_held:
            os.close(self._file)
            self._file = -1
