# SPDX-License-Identifier: GPL-3.0-or-later
"""Geometry with the instances marked on which rays start and end in place, and the hierarchies over it."""

from __future__ import annotations

from collections.abc import Callable, Hashable

import numpy as np

from engine.accel.accelerator import Accelerator
from engine.builder.coincident import find_coincident
from engine.builder.same_place import SamePlace
from engine.scene.content import Kept
from engine.state.geometry import GeometryArrays


class MarkedGeometry:
    """The newest one, and what coincident faces were found.

    These are found by rays through the hierarchies, which depend on them in turn: instances that have some are not
    flattened. So what was found last is taken for granted first, and hierarchies are built once more where it changes.
    """

    def __init__(self) -> None:
        self._coincident: Kept[np.ndarray] = Kept()
        self._latest = np.zeros(0, np.bool_)
        self._marked: Kept[GeometryArrays] = Kept()

    def build(
        self, version: Hashable, same_place: SamePlace, unmarked: GeometryArrays, masks: np.ndarray,
        build_accelerator: Callable[[GeometryArrays], Accelerator], check_cancel: Callable[[], None],
    ) -> tuple[GeometryArrays, Accelerator]:
        """The marked geometry and its hierarchies.

        Parameters
        ----------
        version : hashable
            Of `unmarked` and `same_place`: what was made of an equal one stays.
        masks : uint32 (I,)
            By which rays each instance is found.
        build_accelerator : callable
            Hierarchies over a geometry, at hand or new.
        """

        def build(coincident: np.ndarray) -> tuple[GeometryArrays, Accelerator]:
            key = version, coincident.tobytes()
            marked = self._marked.get(key, lambda: same_place.mark(unmarked, coincident))
            return marked, build_accelerator(marked)

        guess, count = self._latest, len(unmarked.instance_table)
        if len(guess) != count:
            guess = np.zeros(count, np.bool_)
        marked, accelerator = build(guess)
        found = self._latest = self._coincident.get(
            (version, masks.tobytes()),
            lambda: find_coincident(marked, accelerator, check_cancel) & ~same_place.is_clear,
        )
        return (marked, accelerator) if np.array_equal(found, guess) else build(found)
