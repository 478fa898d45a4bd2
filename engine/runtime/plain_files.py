# SPDX-License-Identifier: GPL-3.0-or-later
"""Reading files whose names come from elsewhere: a pipe of that name would have whoever reads it wait for ever."""

from __future__ import annotations

import errno
import os
import stat
from pathlib import Path


def open_at_once(name: str, flags: int) -> int:
    """As `os.open`, for `open(opener=...)`, but that nobody waits for whoever writes to a pipe."""
    return os.open(name, flags | getattr(os, "O_NONBLOCK", 0))


def read_plain(path: Path, most_bytes: int) -> bytes:
    """What a file holds, of larger ones a byte more than `most_bytes`.

    Raises
    ------
    OSError
        If it cannot be read, or is a folder, a pipe or a device.
    """
    with open(path, "rb", opener=open_at_once) as file:
        if not stat.S_ISREG(os.fstat(file.fileno()).st_mode):
            raise OSError(errno.EINVAL, "it is no plain file")
        return file.read(most_bytes + 1)
