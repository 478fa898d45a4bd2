# SPDX-License-Identifier: GPL-3.0-or-later
"""A scene whose light is in groups. Needs bpy."""

from __future__ import annotations

from typing import Any


def grouped(scene: Any) -> None:
    """The cube scene with the sun, a cube that glows and the world in groups of their own."""
    import bpy

    layer = scene.view_layers[0]
    for name in ("Key", "Glow", "Sky"):
        layer.lightgroups.add(name=name)
    scene.objects["Sun"].lightgroup = "Key"
    bpy.ops.mesh.primitive_cube_add(size=0.5, location=(2.0, -1.0, 0.0))
    lamp = bpy.context.object
    lamp.lightgroup = "Glow"
    material = bpy.data.materials.new("Glow")
    material.use_nodes = True
    material.node_tree.nodes["Principled BSDF"].inputs["Emission Strength"].default_value = 5.0
    lamp.data.materials.append(material)
    scene.world = bpy.data.worlds.new("World")
    scene.world.lightgroup = "Sky"


def keyframe(scene: Any, group: str, strengths: dict[int, float]) -> None:
    """Animate the factor of a light group, from frame to frame in a straight line."""
    entry = scene.neuralguide.light_mix[group]
    for frame, strength in strengths.items():
        entry.strength = strength
        entry.keyframe_insert("strength", frame=frame)
    action = scene.animation_data.action
    curves = action.fcurves if hasattr(action, "fcurves") else action.layers[0].strips[0].channelbags[0].fcurves
    for curve in curves:
        for point in curve.keyframe_points:
            point.interpolation = "LINEAR"
