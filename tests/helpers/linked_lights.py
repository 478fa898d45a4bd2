# SPDX-License-Identifier: GPL-3.0-or-later
"""Links between lights and objects, written by hand."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from engine.scene.linking import ALL_SETS, Linking


def no_linking(instance_count: int, light_count: int) -> Linking:
    """Links of every light to everything."""
    sets, bits = np.zeros(instance_count, np.int32), np.full(instance_count, ALL_SETS, np.uint64)
    of_lamps = np.full(light_count, ALL_SETS, np.uint64)
    return Linking(sets, sets, bits, bits, of_lamps, of_lamps)


def linkings(instance_count: int, light_count: int) -> list[Linking]:
    """A lamp that lights one object only, and one in whose light only the others cast shadows."""
    plain = no_linking(instance_count, light_count)
    sets = (np.arange(instance_count) == 1).astype(np.int32)
    lit, hidden = plain.lamp_receivers.copy(), plain.lamp_blockers.copy()
    lit[1], hidden[0] = 2, 1
    return [
        replace(plain, receiver_set=sets, lamp_receivers=lit), replace(plain, blocker_set=sets, lamp_blockers=hidden)
    ]  # fmt: skip
