# SPDX-License-Identifier: GPL-3.0-or-later
"""Memory that the renderer and the worker share: records one way, snapshots the other.

Who may touch what, and when, is said by messages over the worker's pipes, which order memory as well; the checksum in a
snapshot's header catches what is torn all the same.
"""

from __future__ import annotations

import mmap
import zlib
from typing import Any

import numpy as np

from engine.array_types import Float32Array
from engine.guiding.neural.networks.radiance import NetworkShape, Snapshot, TrainableShape, TrainingSettings
from engine.guiding.records.light import Records
from engine.guiding.records.training_rows import pack_training_rows, pick_row
from engine.processes.memory import PAGE, SharedMemory
from engine.runtime.jit import kernel

#: Submissions and snapshots that can be under way at once.
SLOT_COUNT = 2
#: Where the worker finds the snapshot that it is to go on from, until it writes its own.
FIRST_SLOT = 0

_HEADER = np.dtype(
    [
        ("version", np.int64),
        ("step", np.int64),
        ("checksum", np.uint32),
        ("loss", np.float32),
        ("scale", np.float32),
        ("bounds", np.float32, (2, 3)),
    ]
)


@kernel
def pack_rows(records, row_count, taken_count, seed, is_partial, out):
    """Pick records at random and write what training needs of them.

    One record is drawn from each of `taken_count` equal stretches: all of them, in order, if they are not more.
    Records with anything that is not finite are left out; negative radiance counts as none. u is the records' time.

    Parameters
    ----------
    records : Records
    row_count : int, rows of `records` in use
    taken_count : int, at most `row_count`
    seed : uint32
    is_partial : bool
        Radiance may be NaN in some channels: not known, and left so.
    out : float32 (at least taken_count, 6 + channels or one more for u), written

    Returns
    -------
    int
        Rows written; `taken_count` less the rejected ones.
    """
    channel_count = records.radiance.shape[1]
    has_u = out.shape[1] > 6 + channel_count
    written = 0
    for k in range(taken_count):
        row = pick_row(k, row_count, taken_count, seed)
        total = np.float32(0.0)
        for axis in range(3):
            out[written, axis] = records.position[row, axis]
            out[written, 3 + axis] = records.direction[row, axis]
            total += abs(records.position[row, axis]) + abs(records.direction[row, axis])
        known_count = 0
        for channel in range(channel_count):
            value = records.radiance[row, channel]
            if is_partial and not value == value:
                out[written, 6 + channel] = value
                continue
            known_count += 1
            out[written, 6 + channel] = max(value, 0.0)
            total += abs(value)
        if has_u:
            out[written, 6 + channel_count] = records.time[row]
            total += abs(records.time[row])
        # False for NaN and for infinity.
        if total < np.float32(np.inf) and known_count > 0:
            written += 1
    return written


class Channel:
    """The shared memory, mapped. `Channel.create` in the renderer, `Channel.attach` in the worker.

    Parameters
    ----------
    shape : TrainableShape
    slot_rows : int
        Records of one submission at most.
    memory : SharedMemory
        Belongs to the channel from now on.
    """

    def __init__(self, shape: TrainableShape, slot_rows: int, memory: SharedMemory) -> None:
        self.shape = shape
        self.slot_rows = slot_rows
        self.memory = memory

    @staticmethod
    def size(shape: TrainableShape, slot_rows: int) -> int:
        """Bytes of the shared memory."""
        snapshot = _HEADER.itemsize + 4 * shape.parameter_count
        rows = 4 * shape.row_width * slot_rows
        return SLOT_COUNT * (-(-snapshot // PAGE) + -(-rows // PAGE)) * PAGE

    @classmethod
    def create(cls, shape: TrainableShape, settings: TrainingSettings) -> Channel:
        """Reserve the memory.

        Raises
        ------
        OSError
            If there is not enough of it.
        """
        memory = SharedMemory.create(cls.size(shape, settings.submission_rows))
        channel = cls(shape, settings.submission_rows, memory)
        for slot in range(SLOT_COUNT):
            channel._header(slot)["version"] = -1
        return channel

    @property
    def address(self) -> dict[str, Any]:
        """What the worker needs for `attach`."""
        return {**self.memory.address, "slot_rows": self.slot_rows}

    @property
    def address_for_others(self) -> dict[str, Any]:
        """`address` for a process that runs already."""
        return {**self.memory.address_for_others, "slot_rows": self.slot_rows}

    @classmethod
    def attach(cls, shape: TrainableShape, address: dict[str, Any]) -> Channel:
        """The worker's end, from the renderer's `address`."""
        return cls(shape, address["slot_rows"], SharedMemory.attach(address))

    def _block(self, slot: int) -> int:
        return slot * (self.size(self.shape, self.slot_rows) // SLOT_COUNT)

    def _header(self, slot: int) -> np.ndarray:
        return np.frombuffer(self._memory(), _HEADER, 1, self._block(slot))

    def _memory(self) -> mmap.mmap:
        return self.memory.map(self.size(self.shape, self.slot_rows))

    def rows(self, slot: int) -> Float32Array:
        """Records of a slot: float32 (slot_rows, row_width), a view."""
        snapshot = _HEADER.itemsize + 4 * self.shape.parameter_count
        start = self._block(slot) + -(-snapshot // PAGE) * PAGE
        width = self.shape.row_width
        return np.frombuffer(self._memory(), np.float32, self.slot_rows * width, start).reshape(self.slot_rows, width)

    def _parameters(self, slot: int) -> Float32Array:
        start = self._block(slot) + _HEADER.itemsize
        return np.frombuffer(self._memory(), np.float32, self.shape.parameter_count, start)

    def write_snapshot(self, slot: int, snapshot: Snapshot) -> None:
        """Publish a snapshot (worker)."""
        header = self._header(slot)
        header["version"] = -1
        parameters = self._parameters(slot)
        parameters[:] = snapshot.parameters
        header["step"] = snapshot.step
        header["loss"] = snapshot.loss
        header["scale"] = snapshot.scale
        header["bounds"] = snapshot.bounds
        header["checksum"] = zlib.crc32(parameters.data)
        header["version"] = snapshot.version

    def read_snapshot(self, slot: int) -> Snapshot | None:
        """Copy of a slot's snapshot; None if it is torn, being written, or never was (renderer)."""
        header = self._header(slot)[0]
        version = int(header["version"])
        snapshot = Snapshot(
            version,
            int(header["step"]),
            float(header["loss"]),
            float(header["scale"]),
            np.array(header["bounds"]),
            self._parameters(slot).copy(),
        )
        torn = zlib.crc32(snapshot.parameters.data) != int(header["checksum"])
        return None if torn or version < 0 or int(header["version"]) != version else snapshot

    def write_rows(self, slot: int, records: Records | Float32Array, row_count: int, seed: int) -> int:
        """Pick records for a slot (renderer); returns how many of those picked were fit to be written.

        Records for the radiance network, rows of `row_width` floats for those that guide (`training_rows.py`).
        """
        taken = min(row_count, self.slot_rows)
        rows, bits = self.rows(slot), np.uint32(seed & 0xFFFFFFFF)
        if isinstance(records, Records):
            is_partial = isinstance(self.shape, NetworkShape) and self.shape.by_quarter
            return int(pack_rows(records, row_count, taken, bits, is_partial, rows))
        return int(pack_training_rows(records, row_count, taken, bits, rows))

    def close(self) -> None:
        """Give the memory back. Views that are still alive keep the mapping, not the file."""
        self.memory.close()
