# SPDX-License-Identifier: GPL-3.0-or-later
"""The evening room in motion: what moves, a function for each sequence of frames."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import bpy
import numpy as np

from benchmarks.scenes.interiors import materials
from benchmarks.scenes.interiors.evening_room import build
from benchmarks.scenes.interiors.shapes import add_object, primitive

#: Frames of a sequence: 1 to this.
FRAME_COUNT = 24
#: The frame at which a lamp is switched on.
SWITCH_FRAME = 13


def _move(owner: Any, name: str, first: Any, last: Any) -> None:
    """Move a property evenly from the first frame to the last."""
    for frame, value in ((1, first), (FRAME_COUNT, last)):
        setattr(owner, name, value)
        owner.keyframe_insert(name, frame=frame)
    action = owner.animation_data.action
    curves = action.fcurves if hasattr(action, "fcurves") else action.layers[0].strips[0].channelbags[0].fcurves
    for curve in curves:
        for point in curve.keyframe_points:
            point.interpolation = "LINEAR"


def _camera() -> None:
    """The camera drives sideways and turns."""
    camera = bpy.context.scene.camera
    first, turn = tuple(camera.location), tuple(camera.rotation_euler)
    _move(camera, "location", first, (first[0] - 0.5, first[1] + 0.5, first[2]))
    _move(camera, "rotation_euler", turn, (turn[0], turn[1], turn[2] - math.radians(6.0)))


def _object() -> None:
    """A ball rolls along the floor, the vase slides over the table, and the bronze head turns."""
    stripes = materials.wood("Ball wood", (0.10, 0.05, 0.02), (0.62, 0.42, 0.22))
    sphere = bpy.ops.mesh.primitive_uv_sphere_add
    ball = primitive(sphere, "Ball", stripes, radius=0.24, segments=64, ring_count=32, location=(-1.3, -1.3, 0.24))
    _move(ball, "location", (-1.3, -1.3, 0.24), (0.9, -1.3, 0.24))
    _move(ball, "rotation_euler", (0.0, 0.0, 0.0), (0.0, 2.2 / 0.24, 0.0))
    vase, head = bpy.data.objects["Vase"], bpy.data.objects["Bronze head"]
    place, turn = tuple(vase.location), tuple(head.rotation_euler)
    _move(vase, "location", place, (place[0] + 0.5, place[1], place[2]))
    _move(head, "rotation_euler", turn, (turn[0], turn[1], turn[2] - math.radians(50.0)))


def _lamp() -> None:
    """A lamp is carried through the room, and another is switched on."""
    data = bpy.data.lights.new("Carried lamp", "POINT")
    data.energy, data.color, data.shadow_soft_size = 14.0, (1.0, 0.8, 0.5), 0.06
    lamp = add_object("Carried lamp", data)
    _move(lamp, "location", (-1.6, -1.5, 2.0), (1.6, -1.5, 2.0))
    data = bpy.data.lights.new("Switched lamp", "POINT")
    data.color, data.shadow_soft_size = (0.5, 0.7, 1.0), 0.1
    add_object("Switched lamp", data).location = (2.4, 0.5, 1.9)
    for frame, power in ((SWITCH_FRAME - 1, 0.0), (SWITCH_FRAME, 25.0)):
        data.energy = power
        data.keyframe_insert("energy", frame=frame)


def _hair() -> None:
    """Strands stand on the floor in front, and lean to and fro."""
    scene = bpy.context.scene
    scene.cycles_curves.shape = "THICK"
    rng, count, keys = np.random.default_rng(4), 900, 6
    data = bpy.data.hair_curves.new("Strands")
    data.add_curves([keys] * count)
    angle, distance = rng.uniform(0.0, 2.0 * np.pi, count), 0.3 * np.sqrt(rng.uniform(0.0, 1.0, count))
    roots = np.stack((distance * np.cos(angle), distance * np.sin(angle), np.zeros(count)), axis=1)[:, None, :]
    spread = rng.normal(0.0, 0.03, (count, 1, 3)) + (0.0, 0.0, 0.16)
    heights = np.arange(keys)[None, :, None]
    bend = roots * 0.06 * heights**2
    data.position_data.foreach_set("vector", (roots + bend + spread * heights).astype(np.float32).ravel())
    widths = np.broadcast_to(np.linspace(0.006, 0.002, keys), (count, keys))
    radius = data.attributes.get("radius") or data.attributes.new("radius", "FLOAT", "POINT")
    radius.data.foreach_set("value", np.ascontiguousarray(widths, np.float32).ravel())
    data.materials.append(materials.plaster("Straw", (0.62, 0.43, 0.20)))
    strands = add_object("Strands", data)
    strands.location = (-0.45, -1.75, 0.0)
    _blow(strands)


def _blow(strands: Any) -> None:
    """Shift strands along x by the square of their height times a sine of the frame."""
    group = bpy.data.node_groups.new("Wind", "GeometryNodeTree")
    for in_out in ("INPUT", "OUTPUT"):
        group.interface.new_socket("Geometry", in_out=in_out, socket_type="NodeSocketGeometry")
    strands.modifiers.new("Wind", "NODES").node_group = group
    new, link = group.nodes.new, group.links.new

    def calculate(operation: str, *values: Any) -> Any:
        node = new("ShaderNodeMath")
        node.operation = operation
        for socket, value in zip(node.inputs, values, strict=False):
            if isinstance(value, float):
                socket.default_value = value
            else:
                link(value, socket)
        return node.outputs[0]

    given, left, time = new("NodeGroupInput"), new("NodeGroupOutput"), new("GeometryNodeInputSceneTime")
    place, apart, shift = new("GeometryNodeInputPosition"), new("ShaderNodeSeparateXYZ"), new("ShaderNodeCombineXYZ")
    shape = new("GeometryNodeSetPosition")
    link(place.outputs[0], apart.inputs[0])
    phase = calculate("MULTIPLY_ADD", time.outputs["Frame"], 0.45, apart.outputs["X"])
    height = calculate("MULTIPLY", apart.outputs["Z"], apart.outputs["Z"])
    link(calculate("MULTIPLY", calculate("MULTIPLY", calculate("SINE", phase), height), 0.35), shift.inputs["X"])
    link(given.outputs[0], shape.inputs[0])
    link(shift.outputs[0], shape.inputs["Offset"])
    link(shape.outputs[0], left.inputs[0])


#: Sequences by name: what moves in them.
MOTIONS: dict[str, Callable[[], None]] = {"camera": _camera, "object": _object, "lamp": _lamp, "hair": _hair}


def build_moving(motion: str, width: int, height: int) -> bpy.types.Scene:
    """Replace the open file by the evening room in motion, frames 1 to `FRAME_COUNT`.

    Parameters
    ----------
    motion : str
        One of MOTIONS.
    width, height : int
        [pixels]
    """
    scene = build(width, height)
    scene.frame_start, scene.frame_end = 1, FRAME_COUNT
    MOTIONS[motion]()
    return scene
