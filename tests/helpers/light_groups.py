# SPDX-License-Identifier: GPL-3.0-or-later
"""A scene whose light is in groups, which needs bpy, and files that have light groups."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR

#: Pixels of `write_frame`, height and width, and its light groups.
SIZE = (6, 9)
KEY, ODD = "Key", "Küche & Bad (2)"
ROOM_GROUPS = (KEY, ODD)


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


def write_frame(path: Path, seed: int, groups: Sequence[str] = ROOM_GROUPS, mix: Any = None, **other: Any) -> None:
    """Write a frame of light in groups and in none; `mix` is what its metadata says."""
    from addon.light_mix import FIELD

    rng = np.random.default_rng(seed)
    lights = {group: rng.random((3, *SIZE), np.float32) for group in groups}
    picture = sum(lights.values(), np.full((3, *SIZE), 0.5, np.float32))
    channels = {"ViewLayer.Index.X": np.full(SIZE, seed, np.float32), "ViewLayer.Combined.A": np.ones(SIZE, np.float32)}
    for name, planes in [("Combined", picture), *((f"Combined_{group}", light) for group, light in lights.items())]:
        channels |= {f"ViewLayer.{name}.{letter}": plane for letter, plane in zip("RGB", planes, strict=True)}
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage, "Scene": "Room", **other}
    if mix is not None:
        header[FIELD] = mix if isinstance(mix, str) else json.dumps(mix)
    with OpenEXR.File(header, channels) as file:
        file.write(str(path))
