# SPDX-License-Identifier: GPL-3.0-or-later
"""Gives an open file the camera and the light that it lacks, by one rule for all files."""

from __future__ import annotations

import math
from typing import Any

from benchmarks.scene_files import emits

#: From the middle of what is seen towards a camera that was added.
_DIRECTION = (0.55, -0.75, 0.4)
_SUN_STRENGTH, _WORLD_GREY = 3.0, 0.5
_SUN_ROTATION = (math.radians(40.0), math.radians(15.0), math.radians(30.0))


def _bounds(scene: Any) -> tuple[list[float], list[float]]:
    """Corners of the box around all that a render shows, in world space; those of a cube where it shows nothing."""
    import bpy
    from mathutils import Vector

    corners = []
    for instance in bpy.context.evaluated_depsgraph_get().object_instances:
        item = instance.object
        if item.type in ("MESH", "CURVE", "SURFACE", "META", "FONT", "CURVES", "POINTCLOUD", "VOLUME"):
            corners += [instance.matrix_world @ Vector(corner) for corner in item.bound_box]
    if not corners:
        return [-1.0] * 3, [1.0] * 3
    return [min(c[axis] for c in corners) for axis in range(3)], [max(c[axis] for c in corners) for axis in range(3)]


def _add_camera(scene: Any) -> None:
    import bpy
    from mathutils import Vector

    low, high = (Vector(corner) for corner in _bounds(scene))
    radius = max((high - low).length / 2.0, 1e-3)
    camera = bpy.data.cameras.new("Added")
    item = bpy.data.objects.new("Added camera", camera)
    scene.collection.objects.link(item)
    towards = Vector(_DIRECTION).normalized()
    aspect = scene.render.resolution_x / scene.render.resolution_y
    narrow = camera.angle / 2.0 if aspect <= 1.0 else math.atan(math.tan(camera.angle / 2.0) / aspect)
    distance = 0.9 * radius / math.sin(narrow)
    item.location = (low + high) / 2.0 + distance * towards
    item.rotation_euler = towards.to_track_quat("Z", "Y").to_euler()
    camera.clip_start, camera.clip_end = distance * 1e-3, distance * 10.0
    scene.camera = item


def _is_lit(scene: Any) -> bool:
    """Whether a lamp, a material or a map around the scene sends light."""
    world = scene.world
    if world is not None and world.node_tree is not None:
        for node in world.node_tree.nodes:
            if node.type == "BACKGROUND" and node.inputs["Color"].is_linked:
                return True
    for item in scene.objects:
        if item.hide_render:
            continue
        if item.type == "LIGHT" or any(emits(slot.material) for slot in item.material_slots):
            return True
    return False


def _add_light(scene: Any) -> None:
    import bpy

    sun = bpy.data.lights.new("Added", "SUN")
    sun.energy = _SUN_STRENGTH
    item = bpy.data.objects.new("Added sun", sun)
    item.rotation_euler = _SUN_ROTATION
    scene.collection.objects.link(item)
    world = scene.world = bpy.data.worlds.new("Added")
    if world.node_tree is None:
        world.use_nodes = True
    for node in world.node_tree.nodes:
        if node.type == "BACKGROUND":
            node.inputs["Color"].default_value = (_WORLD_GREY, _WORLD_GREY, _WORLD_GREY, 1.0)


def complete(scene: Any) -> list[str]:
    """Add to the open scene what it lacks; returns names of what was added.

    A camera looks at the middle of all that is seen, from above on the right, so far that a sphere around it nearly
    fits. A sun and a grey world are the light where neither lamp, nor material, nor a map of the world sends any.
    """
    added = []
    if not _is_lit(scene):
        _add_light(scene)
        added.append("light")
    if scene.camera is None:
        _add_camera(scene)
        added.append("camera")
    return added
