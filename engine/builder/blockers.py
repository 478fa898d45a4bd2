# SPDX-License-Identifier: GPL-3.0-or-later
"""Shadow linking: masks by which shadow rays meet only what casts shadows in the light that they look for."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from engine.accel.masks import BLOCKER_BITS, BLOCKER_BITS_WITHOUT_CATCHERS
from engine.array_types import Int32Array, Uint32Array
from engine.scene.description import Notice
from engine.scene.linking import Linking, contains


@dataclass
class Blockers:
    """Masks of N instances and L lights.

    Attributes
    ----------
    bits : uint32 (N,)
        What the masks of instances have besides, if they cast shadows.
    surfaces : int32 (N,), lamps : int32 (L,)
        Masks of shadow rays towards them, 0 = everything casts shadows.
    notices : list of Notice
    """

    bits: Uint32Array
    surfaces: Int32Array
    lamps: Int32Array
    notices: list[Notice]


def find_blockers(linking: Linking | None, *, has_catchers: bool) -> Blockers | None:
    """Masks for shadow linking; None where everything casts shadows in all light.

    Where anything is a shadow catcher fewer choices have room in a mask.
    """
    if linking is None:
        return None
    numbers = np.unique(linking.blocker_set).tolist()
    bits = np.zeros(len(linking.blocker_set), np.uint32)
    patterns: dict[bytes, int] = {np.ones(len(numbers), np.bool_).tobytes(): 0}
    notices: list[Notice] = []
    free = BLOCKER_BITS if has_catchers else BLOCKER_BITS_WITHOUT_CATCHERS

    def masks(of_emitters: np.ndarray) -> Int32Array:
        result = np.zeros(len(of_emitters), np.int32)
        for value in np.unique(of_emitters):
            casts = np.array([contains(value, number) for number in numbers], np.bool_)
            if casts.tobytes() not in patterns:
                patterns[casts.tobytes()] = _next_mask(len(patterns) - 1, free, notices)
                of_sets = dict(zip(numbers, casts.tolist(), strict=True))
                is_caster = np.array([of_sets[number] for number in linking.blocker_set.tolist()], np.bool_)
                bits[is_caster] |= np.uint32(patterns[casts.tobytes()])
            result[of_emitters == value] = patterns[casts.tobytes()]
        return result

    surfaces, lamps = masks(linking.surface_blockers), masks(linking.lamp_blockers)
    if not (surfaces.any() or lamps.any()) and not notices:
        return None
    return Blockers(bits, surfaces, lamps, notices)


def _next_mask(known: int, free: tuple[int, ...], notices: list[Notice]) -> int:
    if known < len(free):
        return 1 << free[known]
    if not notices:
        notices.append(
            Notice(
                "scene", f"more than {len(free)} different choices of blockers are not supported",
                "everything casts shadows in the light of the others",
            )
        )
    return 0
