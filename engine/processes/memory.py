# SPDX-License-Identifier: GPL-3.0-or-later
"""Memory that two processes share.

It has no name wherever the system allows it (an anonymous file whose descriptor the other process inherits), so nothing
is left behind when either process is killed, and two renders cannot meet. Who may touch what, and when, is the business
of who uses it.
"""

from __future__ import annotations

import mmap
import os
import tempfile
from pathlib import Path
from typing import Any

#: Whether a file can lose its name and still be handed to another process.
HAS_UNNAMED_FILES = os.name == "posix"
PAGE = 4096


class SharedMemory:
    """A file that lies in memory. `create` in the renderer, `attach` in the process that it starts.

    Parameters
    ----------
    descriptor : int
        Open file; belongs to this object from now on.
    path : Path or None
        Name of that file where the system has no unnamed ones.
    owns_path : bool
        Whether `close` removes that name.
    """

    def __init__(self, descriptor: int, path: Path | None = None, *, owns_path: bool = False) -> None:
        self.descriptor = descriptor
        self._path = path
        self._owns_path = owns_path
        self._map: mmap.mmap | None = None
        self._is_closed = False

    @classmethod
    def create(cls, size: int) -> SharedMemory:
        """Memory of so many bytes, 1 or more.

        Raises
        ------
        OSError
            If there is not enough of it.
        """
        path = None
        if HAS_UNNAMED_FILES:
            descriptor = _anonymous_file()
        else:
            descriptor, name = tempfile.mkstemp(prefix="neuralguide-")
            path = Path(name)
        memory = cls(descriptor, path, owns_path=path is not None)
        try:
            memory.reserve(size)
        except BaseException:
            memory.close()
            raise
        return memory

    @classmethod
    def attach(cls, address: dict[str, Any]) -> SharedMemory:
        """The other process's end, from the renderer's `address`."""
        path = address.get("path")
        if path is None:
            return cls(address["descriptor"])
        return cls(os.open(path, os.O_RDWR | getattr(os, "O_BINARY", 0)), Path(path))

    @property
    def address(self) -> dict[str, Any]:
        """What the other process needs for `attach`."""
        return {"descriptor": self.descriptor} if self._path is None else {"path": str(self._path)}

    @property
    def address_for_others(self) -> dict[str, Any]:
        """`address` for a process that runs already, so that it has inherited nothing (where there is /proc)."""
        return {"path": f"/proc/{os.getpid()}/fd/{self.descriptor}"} if self._path is None else self.address

    @property
    def size(self) -> int:
        """Bytes that the file has now, whoever made it grow."""
        return os.fstat(self.descriptor).st_size

    def reserve(self, size: int) -> None:
        """Grow to so many bytes, if there are fewer.

        They are reserved here and now: to find out at the first write would be a signal that ends the process.

        Raises
        ------
        OSError
            If there is not enough memory.
        """
        before = self.size
        if size <= before:
            return
        if hasattr(os, "posix_fallocate"):
            os.posix_fallocate(self.descriptor, before, size - before)
            return
        os.lseek(self.descriptor, before, os.SEEK_SET)
        for start in range(before, size, PAGE * 256):
            os.write(self.descriptor, bytes(min(PAGE * 256, size - start)))

    def give_back(self) -> None:
        """Shrink to nothing, for the memory; nobody may have it mapped."""
        self.unmap()
        os.ftruncate(self.descriptor, 0)

    def map(self, size: int) -> mmap.mmap:
        """At least the first `size` bytes, mapped; what was mapped before may end.

        Raises
        ------
        ValueError
            If the memory is closed, or the file has fewer bytes.
        OSError
            If the system has no room in this process.
        """
        if self._is_closed:
            raise ValueError("the shared memory is closed")
        if self._map is None or len(self._map) < size:
            self.unmap()
            self._map = mmap.mmap(self.descriptor, max(size, self.size))
        return self._map

    def unmap(self) -> None:
        """Let go of the mapping; `map` makes another one."""
        memory, self._map = self._map, None
        if memory is not None:
            try:
                memory.close()
            except BufferError:
                pass  # A view is alive: the mapping goes with it.

    def close(self) -> None:
        """Give the memory back. Views that are still alive keep the mapping, not the file."""
        if self._is_closed:
            return
        self._is_closed = True
        self.unmap()
        os.close(self.descriptor)
        if self._owns_path and self._path is not None:
            self._path.unlink(missing_ok=True)


def _anonymous_file() -> int:
    if hasattr(os, "memfd_create"):
        return os.memfd_create("neuralguide")
    with tempfile.TemporaryFile() as file:
        return os.dup(file.fileno())
