# SPDX-License-Identifier: GPL-3.0-or-later
"""Values kept for as long as what they were made from stays the same."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Hashable, Sequence
from typing import Any, Generic, TypeVar

import numpy as np

T = TypeVar("T")


def same_content(a: Any, b: Any) -> bool:
    """Whether two pieces of a description say the same, keys included.

    An array that both share counts as equal without being read: what is written into it must come with a new key.

    Parameters
    ----------
    a, b : dataclasses, containers, arrays or plain values
    """
    if a is b:
        return True
    if type(a) is not type(b):
        return False
    if isinstance(a, np.ndarray):
        if a.dtype != b.dtype or a.shape != b.shape:
            return False
        # Bytes, since NaN must be like itself, and 0 unlike -0.
        return a.size == 0 or np.ascontiguousarray(a).data.cast("B") == np.ascontiguousarray(b).data.cast("B")
    if dataclasses.is_dataclass(a):
        names = (item.name for item in dataclasses.fields(a))
        return all(same_content(getattr(a, name), getattr(b, name)) for name in names)
    if isinstance(a, dict):
        return list(a) == list(b) and all(same_content(a[name], b[name]) for name in a)
    if isinstance(a, (list, tuple)):
        return len(a) == len(b) and all(map(same_content, a, b))
    return bool(a == b)


def snapshot(item: Any) -> Any:
    """A copy of a dataclass that shares its arrays, to tell later what has been changed in it."""
    parts = {
        field.name: dict(value)
        for field in dataclasses.fields(item)
        if isinstance(value := getattr(item, field.name), dict)
    }
    return dataclasses.replace(item, **parts)


class Kept(Generic[T]):
    """The newest value of one step of work, and what it was made from.

    Attributes
    ----------
    version : int
        Grows whenever the value is made anew: a key for what is made from it in turn.
    """

    def __init__(self) -> None:
        self._made: tuple[Any, T] | None = None
        self.version = 0

    def get(self, key: Any, make: Callable[[], T]) -> T:
        """The value made from `key`: the one at hand, or a new one. What `make` raises leaves nothing behind.

        Parameters
        ----------
        key : anything that `==` compares as a whole: no arrays
        """
        if self._made is None or self._made[0] != key:
            # Freed first: old and new may not fit into memory together.
            self._made = None
            self.version += 1
            self._made = key, make()
        return self._made[1]

    def drop(self) -> None:
        """Free the value."""
        self._made = None


class Versions:
    """Numbers that tell the contents of keyed items apart: a number stays while key and content do."""

    def __init__(self) -> None:
        self._known: dict[Hashable, list[tuple[Any, int]]] = {}
        self._next = 0

    def forget(self) -> None:
        """Let go of all contents: whatever comes next gets new numbers."""
        self._known = {}

    def of(self, items: Sequence[Any]) -> tuple[int, ...]:
        """Number of each item; items that are not among these are forgotten.

        Parameters
        ----------
        items : sequence of dataclasses with a hashable `key`
        """
        known: dict[Hashable, list[tuple[Any, int]]] = {}
        numbers = []
        for item in items:
            same_key = self._known.get(item.key, [])
            entry = next((entry for entry in same_key if same_content(entry[0], item)), None)
            if entry is None:
                entry = snapshot(item), self._next
                self._next += 1
            known.setdefault(item.key, []).append(entry)
            numbers.append(entry[1])
        self._known = known
        return tuple(numbers)
