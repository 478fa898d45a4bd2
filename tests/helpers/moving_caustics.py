# SPDX-License-Identifier: GPL-3.0-or-later
"""Scenes whose caustics change while the shutter is open: under wide lamps, so that paths find them too."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from engine.scene.description import SceneDescription
from tests.helpers.caustic_scenes import water_scene
from tests.helpers.placed_quads import steps, turned

_QUAD = np.array([(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0)], np.float32)


def moving_pane_scene(size: float = 4.0) -> SceneDescription:
    """A floor, and above it the surface of something like water that flies across the picture, turns and grows."""
    scene = water_scene(size)
    pane = replace(scene.meshes[0], key="pane", name="Pane", vertices=1.4 * _QUAD)
    pane.motion_vertices = np.stack([0.8 * _QUAD, 1.4 * _QUAD, 2.0 * _QUAD])
    scene.meshes.append(pane)
    flat = scene.instances
    flat.mesh = np.array([0, 1], np.int32)
    way = steps(*(turned(0.3 * t, 1, (2.5 * t, 0.0, 1.0), (1.0, 1.0, 1.0)) for t in (-1.0, 0.0, 1.0)))
    flat.transform = np.stack([np.eye(4, dtype=np.float32), way[1]])
    flat.motion = {1: way}
    return scene


def rising_floor_scene(size: float = 4.0) -> SceneDescription:
    """A floor that rises, turns and grows below a pane of still water and a wide lamp, larger than the picture."""
    scene = water_scene(size)
    for key, corners in (("pane", 2.0 * _QUAD), ("tile", 7.0 * _QUAD)):
        scene.meshes.append(replace(scene.meshes[0], key=key, name=key, vertices=corners))
    scene.meshes[2].motion_vertices = np.stack([5.0 * _QUAD, 7.0 * _QUAD, 9.0 * _QUAD])
    flat = scene.instances
    flat.mesh = np.array([2, 1], np.int32)
    way = steps(*(turned(0.5 * t, 2, (0.6 * t, 0.0, 0.4 * t), (1.0, 1.0, 1.0)) for t in (-1.0, 0.0, 1.0)))
    flat.transform = flat.transform.copy()
    flat.transform[0] = way[1]
    flat.motion = {0: way}
    return scene
