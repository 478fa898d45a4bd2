# SPDX-License-Identifier: GPL-3.0-or-later
"""Links between lights and objects, written by hand."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from engine.scene.description import SceneDescription
from engine.scene.linking import ALL_SETS, Linking
from tests.helpers.small_scenes import pit_scene


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


def half_lit_pit() -> SceneDescription:
    """A pit whose floor is in two halves: the sun does not light the one where x is below 0."""
    scene = pit_scene((24, 24))
    flat = scene.instances
    for name in ("transform", "mesh", "material_offset", "visibility", "pass_index", "random", "color", "is_holdout",
                 "dupli_generated", "dupli_uv", "materials"):  # fmt: skip
        values = np.asarray(getattr(flat, name))
        setattr(flat, name, np.concatenate([values[:1], values]))
    flat.name = ["Left", *flat.name]
    extent = float(np.abs(scene.meshes[0].vertices[:, 0]).max())
    for index, side in enumerate((-1.0, 1.0)):
        half = np.diag(np.array([0.5, 1.0, 1.0, 1.0], np.float32))
        half[0, 3] = 0.5 * side * extent
        flat.transform[index] = half
    count = len(flat.transform)
    scene.linking = no_linking(count, 1)
    scene.linking.receiver_set[0] = 1
    scene.linking.lamp_receivers[:] = ALL_SETS - 2
    return scene
