# SPDX-License-Identifier: GPL-3.0-or-later
"""Keys of particle hair out of Blender's memory, where they lie together; its Python gives them one by one.

What a particle system is made of is no interface. So nothing is believed: numbers and addresses that Blender's Python
tells as well must stand where they are expected, before and behind those that are used, and keys of some strands must
be those that Python gives. The system copies the memory, and refuses where there is none. Where anything is not as
expected the caller reads the keys one by one.
"""

from __future__ import annotations

import contextlib
import os
import struct
import sys
from collections.abc import Iterator
from typing import Any

import bpy
import numpy as np
import numpy.typing as npt

from engine.array_types import Float32Array

#: Fewer are soon read one by one.
LEAST_STRANDS = 1 << 12
#: Numbers of four bytes in a key, and which of them is that of its strand's last key. It begins with its place.
_KEY_COLUMNS, _LAST_KEY = 15, 14
#: Strands that are compared with what Python gives.
_COMPARED = 64
#: By how much keys may differ from it, over the largest number: Python's have been through two matrices.
_TOLERANCE = 1e-5
_MEMORY = "/proc/self/mem"

# Where a particle system has what: addresses.
_SETTINGS, _PARENTS, _CHILDREN, _PARENT_PATHS, _CHILD_PATHS = 16, 24, 32, 56, 64
_NAME, _NAME_BYTES = 168, 64
# And numbers: the seed, parents and children, and how many of both have paths.
_SEED, _COUNTS, _COUNTS_FORMAT = 308, 320, "<5i"
_SIZE = 340


def read_paths(owner: bpy.types.Object, system: Any, numbers: range, key_count: int) -> Float32Array | None:
    """Keys of strands in the world, float32 (S, K, 3), of an evaluated object's particle system.

    None where they are to be read one by one: other systems than Linux, few strands, or memory that is not understood.
    """
    if len(numbers) < LEAST_STRANDS or sys.platform != "linux" or sys.byteorder != "little":
        return None
    try:
        with _memory() as memory:
            keys = _read(memory, system, numbers, key_count)
    except (OSError, OverflowError, struct.error):
        return None
    if keys is None or not _are_those_of_python(owner, system, numbers, keys):
        return None
    return keys


@contextlib.contextmanager
def _memory() -> Iterator[int]:
    descriptor = os.open(_MEMORY, os.O_RDONLY)
    try:
        yield descriptor
    finally:
        os.close(descriptor)


def _fill(memory: int, address: int, into: npt.NDArray[Any]) -> None:
    """Copy what lies at an address; OSError where there is no memory."""
    buffer = into.data.cast("B")
    done = 0
    while done < len(buffer):
        read = os.preadv(memory, [buffer[done:]], address + done)
        if read <= 0:
            raise OSError(f"no memory at {address + done:#x}")
        done += read


def _read(memory: int, system: Any, numbers: range, key_count: int) -> Float32Array | None:
    fields = np.empty(_SIZE, np.uint8)
    _fill(memory, system.as_pointer(), fields)
    raw = fields.tobytes()
    parents, children = system.particles, system.child_particles
    are_children = numbers.start >= len(parents)
    if _address(raw, _SETTINGS) != system.settings.as_pointer() or _address(raw, _PARENTS) != parents[0].as_pointer():
        return None
    if are_children and _address(raw, _CHILDREN) != children[0].as_pointer():
        return None
    if raw[_NAME : _NAME + _NAME_BYTES].split(b"\0")[0] != system.name.encode():
        return None
    parent_count, _, child_count, parent_paths, child_paths = struct.unpack_from(_COUNTS_FORMAT, raw, _COUNTS)
    seed = struct.unpack_from("<i", raw, _SEED)[0]
    if (seed, parent_count, child_count) != (system.seed, len(parents), len(children)):
        return None
    first = numbers.start - (parent_count if are_children else 0)
    if not 0 <= first <= first + len(numbers) <= (child_paths if are_children else parent_paths):
        return None
    paths = np.empty(len(numbers), np.int64)
    _fill(memory, _address(raw, _CHILD_PATHS if are_children else _PARENT_PATHS) + first * paths.itemsize, paths)
    return _read_keys(memory, paths, key_count)


def _address(raw: bytes, at: int) -> int:
    return int(struct.unpack_from("<Q", raw, at)[0])


def _read_keys(memory: int, paths: npt.NDArray[np.int64], key_count: int) -> Float32Array | None:
    """Keys of strands by their addresses; runs of them lie one behind the other."""
    row_bytes = 4 * key_count * _KEY_COLUMNS
    steps = np.diff(paths)
    if (paths <= 0).any() or ((steps >= 0) & (steps < row_bytes)).any() or not (steps == row_bytes).any():
        return None
    begins = np.concatenate([[0], np.flatnonzero(steps != row_bytes) + 1, [len(paths)]])
    keys = np.empty((len(paths), key_count, 3), np.float32)
    for begin, end in zip(begins[:-1].tolist(), begins[1:].tolist(), strict=True):
        rows = np.empty((end - begin, key_count, _KEY_COLUMNS), np.float32)
        _fill(memory, int(paths[begin]), rows)
        keys[begin:end] = rows[:, :, :3]
        last = rows.view(np.int32)[:, 0, _LAST_KEY]
        # Shorter strands end where they are; such as have no key at all are at zero, as Python has them.
        short = np.flatnonzero(last < key_count - 1)
        at = np.minimum(np.arange(key_count), np.maximum(last[short], 0)[:, None])
        keys[begin + short] = np.take_along_axis(rows[short, :, :3], at[:, :, None], axis=1)
        keys[begin + np.flatnonzero(last < 0)] = 0.0
    return keys


def _are_those_of_python(owner: bpy.types.Object, system: Any, numbers: range, keys: Float32Array) -> bool:
    rows = np.unique(np.linspace(0, len(numbers) - 1, _COMPARED).astype(np.int64)).tolist()
    read, count = system.co_hair, keys.shape[1]
    told = np.array(
        [[read(object=owner, particle_no=numbers[row], step=step)[:] for step in range(count)] for row in rows],
        np.float32,
    )
    mine = keys[rows]
    # Keys that a strand does not have are zeros there.
    is_ended = (told == 0.0).all(axis=2) & (np.arange(count) > 0)
    difference = np.where(is_ended[:, :, None], 0.0, np.abs(mine - told))
    return bool(np.isfinite(mine).all() and difference.max() <= _TOLERANCE * max(np.abs(told).max(), 1e-3))
