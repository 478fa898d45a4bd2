# SPDX-License-Identifier: GPL-3.0-or-later
"""What Simplify leaves out of a scene: what the camera does not see, and what is far from it."""

from __future__ import annotations

from typing import Any

import bpy

from benchmarks.scenes.registry import scene
from benchmarks.scenes.studio import add_object, box, diffuse, light, quad, show, stage, world


def _floating(name: str, x: float, y: float, z: float, **wanted: bool) -> Any:
    """A plate in the air, whose shadow tells whether it is there."""
    made = add_object(name, quad(name, diffuse((0.6, 0.2, 0.2), name), 1.2, 1.2), (x, y, z))
    for setting, value in wanted.items():
        setattr(made.cycles, setting, value)
    return made


@scene("simplify-culled")
def culled() -> None:
    """Plates beyond the edge or far away, which want to be culled by view, by distance, by both or not at all."""
    stage()
    world((0.3, 0.3, 0.35))
    show(diffuse((0.7, 0.6, 0.5)))
    light("SUN", 2.0, (0.3, -0.2, 4.0), angle=0.05)
    settings = bpy.context.scene.cycles
    bpy.context.scene.render.use_simplify = True
    settings.use_camera_cull = settings.use_distance_cull = True
    settings.camera_cull_margin, settings.distance_cull_margin = 0.2, 7.0
    _floating("kept", -1.2, -1.2, 4.5)
    _floating("out of view", 0.0, -1.4, 4.5, use_camera_cull=True)
    _floating("behind", 0.0, -7.5, 1.0, use_camera_cull=True)
    _floating("in the margin", 1.4, 0.0, 2.4, use_camera_cull=True)
    _floating("far", -2.6, 3.0, 2.0, use_distance_cull=True)
    _floating("near", 2.4, -0.8, 1.6, use_distance_cull=True)
    _floating("out of view and near", -0.2, 0.8, 4.0, use_camera_cull=True, use_distance_cull=True)
    holder = bpy.data.collections.new("held")
    inner = add_object("held", box("held", diffuse((0.2, 0.6, 0.2), "green"), (0.5, 0.5, 0.5)), (0.0, 0.0, 0.0))
    inner.cycles.use_distance_cull = True
    bpy.context.scene.collection.objects.unlink(inner)
    holder.objects.link(inner)
    for number, y in enumerate((-1.5, 4.5)):
        empty = add_object(f"empty {number}", None, (1.9, y, 0.4))
        empty.instance_type, empty.instance_collection = "COLLECTION", holder
