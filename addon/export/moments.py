# SPDX-License-Identifier: GPL-3.0-or-later
"""Recognises what the dependency graph shows at one time among what it shows at another."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from engine.array_types import Float32Array, Int32Array

from .context import ExportContext

#: Numbers in Blender's persistent id of an instance.
_ID_SIZE = 8


@dataclass
class Moment:
    """What the dependency graph shows at one time, item by item.

    Attributes
    ----------
    keys : int32 (N, 9)
        Who an item is: its row among pairs of object and instancer, and its persistent id.
    transform : float32 (N, 4, 4), object to world
    data : list of datablocks, evaluated
        To be used before the time changes.
    """

    keys: Int32Array
    transform: Float32Array
    data: list[Any]


@dataclass
class Observer:
    """Looks at the dependency graph at different times, and gives the same keys to the same items.

    Evaluated datablocks may be made anew at any time: only original ones say who is who.
    """

    context: ExportContext
    _pairs: dict[tuple[Any, ...], int] = field(default_factory=dict)

    def look(self) -> Moment:
        """Everything shown now."""
        instances = self.context.depsgraph.object_instances
        seen: dict[tuple[Any, ...], int] = {}
        rows: list[int] = []
        data: list[Any] = []
        for item in instances:
            shown, source, parent = item.object, item.instance_object, item.parent
            content = shown.data
            # A curve is shown beside the mesh that is made of it.
            kind = (type(content), item.show_self)
            key = (source or shown.as_pointer(), parent, kind)
            row = seen.get(key)
            if row is None:
                pair = ((source or shown).original, parent and parent.original, kind)
                row = seen[key] = self._pairs.setdefault(pair, len(self._pairs))
            rows.append(row)
            data.append(content)
        count = len(rows)
        matrices = np.empty(count * 16, np.float32)
        instances.foreach_get("matrix_world", matrices)
        identifiers = np.empty(count * _ID_SIZE, np.int32)
        instances.foreach_get("persistent_id", identifiers)
        keys = np.empty((count, 1 + _ID_SIZE), np.int32)
        keys[:, 0] = rows
        keys[:, 1:] = identifiers.reshape(count, _ID_SIZE)
        # Blender stores columns.
        return Moment(keys, matrices.reshape(count, 4, 4).transpose(0, 2, 1), data)


def find_again(before: Int32Array, now: Int32Array) -> npt.NDArray[np.intp]:
    """Where the items of one moment are in another, intp (N,), -1 = nowhere; equal keys are told apart by order."""
    if np.array_equal(before, now):
        return np.arange(len(before))
    places: dict[bytes, list[int]] = {}
    for row in range(len(now) - 1, -1, -1):
        places.setdefault(now[row].tobytes(), []).append(row)
    found = np.full(len(before), -1, np.intp)
    for row in range(len(before)):
        left = places.get(before[row].tobytes())
        if left:
            found[row] = left.pop()
    return found
