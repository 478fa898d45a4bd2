# SPDX-License-Identifier: GPL-3.0-or-later
"""Which objects each emitter lights, and which cast shadows in its light."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from engine.array_types import Int32Array

#: Sets that there may be, as in Cycles: number 0 holds what is in no collection of any emitter.
MOST_SETS = 64
#: Emitters that light, or whose light is blocked by, everything.
ALL_SETS = 2**MOST_SETS - 1


@dataclass
class Linking:
    """Light linking and shadow linking of N instances and L lights.

    Every instance is in one set of receivers and in one of blockers. An emitter has a bit for each set: whether it
    lights those in it, and whether they cast shadows in its light.

    Attributes
    ----------
    receiver_set, blocker_set : int32 (N,)
        0 to MOST_SETS - 1.
    surface_receivers, surface_blockers : uint64 (N,)
        Bits of what an instance emits.
    lamp_receivers, lamp_blockers : uint64 (L,)
        Bits of `SceneDescription.lights`.
    """

    receiver_set: Int32Array
    blocker_set: Int32Array
    surface_receivers: np.ndarray
    surface_blockers: np.ndarray
    lamp_receivers: np.ndarray
    lamp_blockers: np.ndarray

    def check(self, instance_count: int, light_count: int) -> None:
        """Raise ValueError where lengths or sets are not those of the scene."""
        of_instances = (self.receiver_set, self.blocker_set, self.surface_receivers, self.surface_blockers)
        of_lamps = (self.lamp_receivers, self.lamp_blockers)
        if any(len(array) != instance_count for array in of_instances):
            raise ValueError(f"linking: arrays of instances must have {instance_count} elements, one an instance")
        if any(len(array) != light_count for array in of_lamps):
            raise ValueError(f"linking: arrays of lamps must have {light_count} elements, one a light")
        for name in ("receiver_set", "blocker_set"):
            sets = getattr(self, name)
            if len(sets) and not (0 <= sets.min() and sets.max() < MOST_SETS):
                raise ValueError(f"linking: {name} must be from 0 to {MOST_SETS - 1}")


def contains(bits: np.ndarray, number: int) -> np.ndarray:
    """Whether sets of bits, uint64 (N,), have bit `number`: bool (N,)."""
    return ((bits >> np.uint64(number)) & np.uint64(1)) != 0
