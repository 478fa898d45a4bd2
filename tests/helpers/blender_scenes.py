# SPDX-License-Identifier: GPL-3.0-or-later
"""Empty Blender files, and what the exporter makes of the current one. Needs bpy."""

from __future__ import annotations

from typing import Any

from engine.scene.description import SceneDescription


def empty_scene() -> Any:
    """The scene of an empty file, with a camera at the origin."""
    import bpy

    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    scene.camera = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
    scene.collection.objects.link(scene.camera)
    return scene


def export(**arguments: Any) -> SceneDescription:
    """The description of the scene at its current frame; `arguments` as those of `export_scene`."""
    import bpy

    from addon.export import export_scene

    return export_scene(bpy.context.evaluated_depsgraph_get(), **arguments)
