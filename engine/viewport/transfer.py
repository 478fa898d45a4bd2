# SPDX-License-Identifier: GPL-3.0-or-later
"""Updates through shared memory: arrays that the process has already are only named.

An array is known by the object that it is. Who sends must not write into an array that was sent: a change is a new
array (the export makes new ones).
"""

from __future__ import annotations

import io
import pickle
from typing import Any

import numpy as np

from engine.processes.memory import SharedMemory
from engine.viewport.view import Update

#: Smaller arrays are sent each time [bytes].
_LEAST_BYTES = 1024
#: Arrays begin at multiples of this [bytes].
_ALIGNMENT = 64
_LENGTH = 8


class _Pickler(pickle.Pickler):
    """Names large arrays instead of writing them."""

    def __init__(self, file: io.BytesIO, known: dict[int, tuple[int, np.ndarray]], next_token: int) -> None:
        super().__init__(file, protocol=5)
        self._known = known
        self.next_token = next_token
        #: By address: token and array, of all large arrays met; and those among them that are new.
        self.met: dict[int, tuple[int, np.ndarray]] = {}
        self.new: list[tuple[int, np.ndarray]] = []

    def persistent_id(self, item: Any) -> int | None:
        if type(item) is not np.ndarray or item.nbytes < _LEAST_BYTES:
            return None
        entry = self.met.get(id(item)) or self._known.get(id(item))
        if entry is None:
            entry = self.next_token, item
            self.next_token += 1
            self.new.append(entry)
        self.met[id(item)] = entry
        return entry[0]


class _Unpickler(pickle.Unpickler):
    def __init__(self, file: io.BytesIO, arrays: dict[int, np.ndarray]) -> None:
        super().__init__(file)
        self._arrays = arrays

    def persistent_load(self, token: int) -> np.ndarray:
        return self._arrays[token]


class Sender:
    """The host's end. Holds the arrays of the newest scene that was sent, which are to be named by it."""

    def __init__(self, memory: SharedMemory) -> None:
        self._memory = memory
        self._known: dict[int, tuple[int, np.ndarray]] = {}
        self._next_token = 0

    def write(self, update: Update) -> int:
        """Write an update to where the last one was, which must have been read; returns its size in bytes.

        Raises
        ------
        OSError
            If there is not enough shared memory. Nothing is known to be sent then.
        """
        file = io.BytesIO()
        pickler = _Pickler(file, self._known, self._next_token)
        pickler.dump(update)
        start = 0
        table = []
        for token, array in pickler.new:
            table.append((token, array.dtype.str, array.shape, start))
            start += -(-array.nbytes // _ALIGNMENT) * _ALIGNMENT
        keeps = None if update.scene is None else [token for token, _ in pickler.met.values()]
        head = pickle.dumps((table, keeps, file.getvalue()), protocol=5)
        first = -(-(_LENGTH + len(head)) // _ALIGNMENT) * _ALIGNMENT
        size = first + start
        self._memory.reserve(size)
        memory = self._memory.map(size)
        memory[:_LENGTH] = len(head).to_bytes(_LENGTH, "little")
        memory[_LENGTH : _LENGTH + len(head)] = head
        for (_, array), (_, _, shape, offset) in zip(pickler.new, table, strict=True):
            target: np.ndarray = np.ndarray(shape, array.dtype, memory, first + offset)
            target[...] = array
            del target
        self._next_token = pickler.next_token
        if update.scene is not None:
            self._known = pickler.met
        return size

    def give_back(self) -> None:
        """Free the shared memory, once the last update has been read."""
        self._memory.give_back()


class Receiver:
    """The process's end. Holds the arrays of the newest scene."""

    def __init__(self, memory: SharedMemory) -> None:
        self._memory = memory
        self._arrays: dict[int, np.ndarray] = {}

    def read(self, size: int) -> Update:
        """The update that was written, of so many bytes, copied."""
        memory = self._memory.map(size)
        length = int.from_bytes(memory[:_LENGTH], "little")
        table, keeps, body = pickle.loads(memory[_LENGTH : _LENGTH + length])
        first = -(-(_LENGTH + length) // _ALIGNMENT) * _ALIGNMENT
        for token, kind, shape, offset in table:
            self._arrays[token] = np.ndarray(shape, np.dtype(kind), memory, first + offset).copy()
        self._memory.unmap()
        update = _Unpickler(io.BytesIO(body), self._arrays).load()
        if keeps is not None:
            self._arrays = {token: self._arrays[token] for token in keeps}
        return update
