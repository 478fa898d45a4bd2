# SPDX-License-Identifier: GPL-3.0-or-later
"""Pixels in a file, mapped into memory: the system reads what is looked up, and takes memory back where it is short.

The file has no name where the system allows that, and is gone with the last array of it, however the process ends.
"""

from __future__ import annotations

import errno
import mmap
import os
import shutil
import tempfile
import weakref
from pathlib import Path

import numpy as np
import numpy.typing as npt

_PAGE = mmap.PAGESIZE
_STATM = Path("/proc/self/statm")


class TexelFile:
    """An array in a file.

    Parameters
    ----------
    count : int, of values, 1 or more
    dtype : of the values
    folder : str, for the file

    Attributes
    ----------
    values : of dtype, (count,), zero at first; mapped, so that it can be kept beyond this object

    Raises
    ------
    ValueError
        Where there is no room, or the folder cannot be written to.
    """

    def __init__(self, count: int, dtype: npt.DTypeLike, folder: str) -> None:
        self._folder = folder
        self._item = np.dtype(dtype).itemsize
        nbytes = count * self._item
        check_room(nbytes, folder)
        try:
            self._file = tempfile.TemporaryFile(prefix="neuralguide-", dir=folder, buffering=0)
            # Arrays need the mapped memory only, which stays without the file object.
            weakref.finalize(self, self._file.close)
            self._file.truncate(nbytes)
            self._map = mmap.mmap(self._file.fileno(), nbytes)
        except OSError as error:
            raise ValueError(f"textures do not fit into memory, and no file can be made for them in {folder}: "
                             f"{error.strerror or error}") from None
        if hasattr(mmap, "MADV_RANDOM"):
            # Neighbours in the file are seldom neighbours on a surface: none is read ahead.
            self._map.madvise(mmap.MADV_RANDOM)
        self.values = np.frombuffer(self._map, dtype)

    def write(self, first: int, values: np.ndarray) -> None:
        """Put values at index `first`, through the file: where the disk is full, writing to mapped memory would end
        the process.

        Raises
        ------
        ValueError
            Where the disk is full.
        """
        self._file.seek(first * self._item)
        rest = np.ascontiguousarray(values).data.cast("B")
        try:
            while rest:
                rest = rest[self._file.write(rest) or 0 :]
        except OSError as error:
            if error.errno != errno.ENOSPC:
                raise
            raise ValueError(_no_room(len(rest), self._folder)) from None

    def let_go(self) -> None:
        """Let the system have the memory: what is looked up from now on is read from the file."""
        if hasattr(mmap, "MADV_DONTNEED") and os.name == "posix":
            self._map.madvise(mmap.MADV_DONTNEED)


def check_room(nbytes: int, folder: str) -> None:
    """Refuse what the folder's disk has no room for.

    Raises
    ------
    ValueError
        Saying what to do.
    """
    try:
        free = shutil.disk_usage(folder).free
    except OSError:
        return
    if nbytes > free:
        raise ValueError(_no_room(nbytes, folder))


def _no_room(nbytes: int, folder: str) -> str:
    return (
        f"textures do not fit into memory, and {folder} has no room for {nbytes / 2**30:.1f} GiB of them: use smaller "
        "images, free disk space, raise Texture Memory, or choose another folder for temporary files in Blender's "
        "preferences (File Paths)"
    )


def mapped_memory() -> int:
    """Memory of this process that files are mapped into [bytes]; 0 where the system does not tell."""
    try:
        return int(_STATM.read_text(encoding="ascii").split()[2]) * _PAGE
    except (OSError, ValueError, IndexError):
        return 0
