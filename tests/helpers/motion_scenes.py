# SPDX-License-Identifier: GPL-3.0-or-later
"""What tests of motion blur share: keyframes, the shutter, and where things are at any time."""

from __future__ import annotations

from typing import Any

import numpy as np

from tests.helpers.blender_scenes import empty_scene


def keyframe(owner: Any, path: str, values: dict[float, Any], interpolation: str = "LINEAR") -> None:
    """Set keyframes of a property (frame: value), and how they are joined."""
    for frame, value in values.items():
        setattr(owner, path, value)
        owner.keyframe_insert(path, frame=frame)
    for curve in curves_of(owner):
        if curve.data_path == owner.path_from_id(path):
            for point in curve.keyframe_points:
                point.interpolation = interpolation


def curves_of(owner: Any) -> list[Any]:
    """Animation curves of a datablock."""
    action = owner.id_data.animation_data.action
    bags = [bag for layer in action.layers for strip in layer.strips for bag in strip.channelbags]
    return [curve for bag in bags for curve in bag.fcurves]


def open_shutter(scene: Any, length: float = 1.0, position: str = "CENTER") -> None:
    """Turn motion blur on."""
    scene.render.use_motion_blur = True
    scene.render.motion_blur_shutter = length
    scene.render.motion_blur_position = position


def blurred_scene() -> Any:
    """An empty file with a camera, at frame 10, its shutter open for a frame."""
    scene = empty_scene()
    scene.frame_set(10)
    open_shutter(scene)
    return scene


def add_cube(name: str = "Cube") -> Any:
    """A cube in the scene."""
    import bpy

    bpy.ops.mesh.primitive_cube_add()
    cube = bpy.context.object
    cube.name = name
    return cube


def matrix_at(item: Any, time: float) -> Any:
    """Where Blender itself has an object at a time, float32 (4, 4); the frame is as before afterwards."""
    import bpy

    scene = bpy.context.scene
    found = scene.frame_current, scene.frame_subframe
    frame = int(np.floor(time))
    scene.frame_set(frame, subframe=time - frame)
    matrix = np.array(item.evaluated_get(bpy.context.evaluated_depsgraph_get()).matrix_world, np.float32)
    scene.frame_set(found[0], subframe=found[1])
    return matrix
