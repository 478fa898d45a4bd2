# SPDX-License-Identifier: GPL-3.0-or-later
"""Caustics of lamps in whose light only some objects cast shadows."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from engine.scene.description import SceneDescription
from engine.scene.linking import ALL_SETS
from tests.helpers.caustic_scenes import glass, lamp_at
from tests.helpers.linked_lights import no_linking
from tests.helpers.small_scenes import floor_scene, material

_FLOOR, _WATER, _SCREEN = range(3)


def _at_height(z: float, scale: float = 1.0) -> np.ndarray:
    matrix = np.diag([scale, scale, 1.0, 1.0]).astype(np.float32)
    matrix[2, 3] = z
    return matrix


def _three(third: np.ndarray, materials, lights) -> SceneDescription:
    """A floor, over its middle something like water, and something above both."""
    scene = floor_scene(
        lights=lights, transforms=[np.eye(4), _at_height(1.0, 0.03), third], materials=materials, size=(16, 16)
    )
    scene.instances.material_offset = np.arange(3, dtype=np.int32)
    scene.instances.materials = np.arange(3, dtype=np.int32)
    scene.linking = no_linking(3, len(lights))
    return scene


def screened_water(passes: int | None) -> SceneDescription:
    """Water of 3 m under a wide lamp and a screen of 2 m: one of the two casts no shadow in the lamp's light.

    Parameters
    ----------
    passes : int or None
        Which lets it through: 1 the water, 2 the screen; None: nothing does.
    """
    scene = _three(_at_height(2.0, 0.02), [material(), glass(1.33), material("Screen")], [lamp_at(0.0, 0.0, 3.0, 4.0)])
    if passes is not None:
        scene.linking.blocker_set = (np.arange(3) == passes).astype(np.int32)
        scene.linking.lamp_blockers = np.full(1, ALL_SETS - 2, np.uint64)
    return scene


def lit_by_a_mesh(roughness: float = 0.0) -> SceneDescription:
    """Water under a glowing square, in whose light the floor casts no shadow, which makes no difference."""
    glow = material("Glow", (4.0, 3.0, 2.0), "ShaderNodeEmission")
    scene = _three(_at_height(3.0, 0.04), [material(), glass(1.33, roughness), replace(glow)], [])
    scene.linking.blocker_set = (np.arange(3) == _FLOOR).astype(np.int32)
    scene.linking.surface_blockers = np.full(3, ALL_SETS - 2, np.uint64)
    return scene
