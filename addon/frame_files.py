# SPDX-License-Identifier: GPL-3.0-or-later
"""Files of frames that several processes render between them: which are finished, and who is at those that are not.

An empty file says that somebody has begun a frame, as Blender's Placeholders do. Whoever begins it here also locks the
file while the frame is rendered. The system frees the lock when the process ends, however it ends, so that what a
killed process leaves behind is nobody's.
"""

from __future__ import annotations

import contextlib
import errno
import os
import struct
import sys
from collections.abc import Sequence
from pathlib import Path

from .output_files import is_whole, was_interrupted

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None  # type: ignore[assignment]

#: No picture is shorter, and shorter files do not even tell their format.
_LEAST_BYTES = 24
#: The byte that is locked: beyond what any picture has, since some network file systems keep others from writing where
#: a lock is.
_LOCKED_BYTE = 1 << 40
#: What a lock is refused with that another process has.
_TAKEN = (errno.EACCES, errno.EAGAIN)


def is_finished(path: Path) -> bool:
    """Whether a file is a frame: whole, and of a render that nobody has interrupted."""
    try:
        return path.stat().st_size >= _LEAST_BYTES and is_whole(path) and not was_interrupted(path)
    except OSError:
        return False


class FrameClaim:
    """The right to render a frame, held until `release`.

    Parameters
    ----------
    paths : sequence of Path
        Its files.
    makes_placeholders : bool
        Whether there is to be an empty file where there is none. Without, only files that are there can be claimed.
    """

    def __init__(self, paths: Sequence[Path], *, makes_placeholders: bool) -> None:
        self._paths = paths
        self._flags = os.O_RDWR | (os.O_CREAT if makes_placeholders else 0)
        self._held: list[tuple[Path, int]] = []

    def take(self) -> bool:
        """Claim the frame; False: another process renders it.

        Raises
        ------
        OSError
            If a file cannot be made, or not be written.
        """
        for path in self._paths:
            try:
                is_taken = self._take(path)
            except FileNotFoundError:
                if self._flags & os.O_CREAT:
                    raise
                continue
            if not is_taken:
                self.release()
                return False
        return True

    def _take(self, path: Path) -> bool:
        if self._flags & os.O_CREAT:
            path.parent.mkdir(parents=True, exist_ok=True)
        while True:
            file = os.open(path, self._flags, 0o666)
            if not _lock(file):
                os.close(file)
                return False
            try:
                if os.path.samestat(os.fstat(file), path.stat()):
                    self._held.append((path, file))
                    return True
            except FileNotFoundError:
                pass
            # Whoever had it has given it up meanwhile, and its file is gone.
            os.close(file)

    def release(self) -> None:
        """Let others have the frame; what is still empty goes."""
        for path, file in self._held:
            with contextlib.suppress(OSError):
                if os.fstat(file).st_size == 0:
                    path.unlink()
            os.close(file)
        self._held = []


def _lock(file: int) -> bool:
    """Lock a file until it is closed, by this process or by its end; False where another process has."""
    if fcntl is None:
        return True
    try:
        if sys.platform == "linux":
            # The lock is this open file's: other kinds go when any file of the process at the same path is closed.
            lock = struct.pack("hhqqi0q", fcntl.F_WRLCK, os.SEEK_SET, _LOCKED_BYTE, 1, 0)
            fcntl.fcntl(file, fcntl.F_OFD_SETLK, lock)
        else:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        # Some file systems have no locks: there a frame may be rendered twice, and none is left out.
        return error.errno not in _TAKEN
    return True
