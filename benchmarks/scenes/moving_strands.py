# SPDX-License-Identifier: GPL-3.0-or-later
"""Motion blur of hair, curves and points that change their shape while the shutter is open."""

from __future__ import annotations

from typing import Any

import bpy
import numpy as np

from benchmarks.scenes.registry import scene
from benchmarks.scenes.studio import add_object, diffuse, lit_stage, sphere

_FRAME = 10


def _shutter() -> None:
    """Motion blur over a frame, open all the time."""
    now = bpy.context.scene
    now.frame_set(_FRAME)
    now.render.use_motion_blur, now.render.motion_blur_shutter = True, 1.0
    now.render.motion_blur_position = "CENTER"
    curve = now.render.motion_blur_shutter_curve.curves[0]
    for point in curve.points:
        point.location.y = 1.0
    now.render.motion_blur_shutter_curve.update()


def _nodes(owner: Any) -> Any:
    """An empty tree of geometry nodes of an object, with its ends."""
    group = bpy.data.node_groups.new("Moves", "GeometryNodeTree")
    group.interface.new_socket("Geometry", in_out="INPUT", socket_type="NodeSocketGeometry")
    group.interface.new_socket("Geometry", in_out="OUTPUT", socket_type="NodeSocketGeometry")
    owner.modifiers.new("Moves", "NODES").node_group = group
    return group


def _lean(owner: Any, sizing: str, radius: float) -> None:
    """Shift what is high up along x, and swell: more with each frame, by geometry nodes."""
    group = _nodes(owner)
    new, link = group.nodes.new, group.links.new
    given, left, time = new("NodeGroupInput"), new("NodeGroupOutput"), new("GeometryNodeInputSceneTime")
    place, apart, shift = new("GeometryNodeInputPosition"), new("ShaderNodeSeparateXYZ"), new("ShaderNodeCombineXYZ")
    ahead, moved, wide = new("ShaderNodeMath"), new("ShaderNodeMath"), new("ShaderNodeMath")
    ahead.operation, moved.operation, wide.operation = "SUBTRACT", "MULTIPLY", "MULTIPLY_ADD"
    shape, size = new("GeometryNodeSetPosition"), new(sizing)
    ahead.inputs[1].default_value = 10.0
    wide.inputs[1].default_value, wide.inputs[2].default_value = radius, 1.5 * radius
    link(time.outputs["Frame"], ahead.inputs[0])
    link(place.outputs[0], apart.inputs[0])
    link(apart.outputs["Z"], moved.inputs[0])
    link(ahead.outputs[0], moved.inputs[1])
    link(moved.outputs[0], shift.inputs["X"])
    link(ahead.outputs[0], wide.inputs[0])
    link(given.outputs[0], shape.inputs[0])
    link(shift.outputs[0], shape.inputs["Offset"])
    link(shape.outputs[0], size.inputs[0])
    link(wide.outputs[0], size.inputs["Radius"])
    link(size.outputs[0], left.inputs[0])


@scene("moving-hair")
def hair() -> None:
    """Round particle hair on a ball that grows by a shape key, which the hair follows."""
    lit_stage()
    bpy.context.scene.cycles_curves.shape = "THICK"
    ball = add_object("ball", sphere("ball", diffuse((0.7, 0.45, 0.25), "brown"), 0.5), (0.0, 0.0, 1.0))
    settings = ball.modifiers.new("fur", "PARTICLE_SYSTEM").particle_system.settings
    settings.type, settings.count, settings.hair_length, settings.render_step = "HAIR", 400, 0.4, 3
    settings.radius_scale, settings.root_radius, settings.tip_radius = 0.05, 1.0, 0.3
    ball.shape_key_add(name="Basis")
    grown = ball.shape_key_add(name="Grown")
    for point in grown.data:
        point.co.x *= 2.2
    for frame, value in ((_FRAME - 1, 0.0), (_FRAME + 1, 1.0)):
        grown.value = value
        grown.keyframe_insert("value", frame=frame)
    ball.cycles.motion_steps = 2
    _shutter()


@scene("moving-curves")
def curves() -> None:
    """A Curves object whose strands lean over and swell by geometry nodes."""
    lit_stage()
    bpy.context.scene.cycles_curves.shape = "THICK"
    rng = np.random.default_rng(4)
    data = bpy.data.hair_curves.new("strands")
    data.add_curves([5] * 200)
    roots = rng.uniform(-1.0, 1.0, (200, 1, 3)) * (1.2, 0.6, 0.0)
    steps = np.arange(5)[None, :, None] * (rng.normal(0.0, 0.05, (200, 1, 3)) + (0.0, 0.0, 0.4))
    data.position_data.foreach_set("vector", (roots + steps).astype(np.float32).ravel())
    data.materials.append(diffuse((0.3, 0.6, 0.3), "green"))
    strands = add_object("strands", data)
    _lean(strands, "GeometryNodeSetCurveRadius", 0.02)
    strands.cycles.motion_steps = 2
    _shutter()


@scene("moving-points")
def points() -> None:
    """A cloud of points that lean over and swell by geometry nodes."""
    lit_stage()
    _lean(_cloud(), "GeometryNodeSetPointRadius", 0.06)
    _shutter()


@scene("flying-points")
def flying() -> None:
    """Points that fly by their velocities, whatever is there at other times."""
    lit_stage()
    cloud = _cloud().data
    count = len(cloud.points)
    cloud.attributes["radius"].data.foreach_set("value", np.full(count, 0.06, np.float32))
    rng = np.random.default_rng(6)
    velocity = cloud.attributes.new("velocity", "FLOAT_VECTOR", "POINT")
    velocity.data.foreach_set("vector", rng.normal(0.0, 10.0, (count, 3)).astype(np.float32).ravel())
    _shutter()


def _cloud() -> Any:
    # Only an operator makes points.
    bpy.ops.object.pointcloud_random_add()
    cloud = bpy.context.object
    count = len(cloud.data.points)
    rng = np.random.default_rng(5)
    where = rng.uniform(-1.0, 1.0, (count, 3)) * (1.2, 0.8, 0.8) + (0.0, 0.0, 1.0)
    cloud.data.attributes["position"].data.foreach_set("vector", where.astype(np.float32).ravel())
    cloud.data.materials.append(diffuse((0.6, 0.3, 0.3), "red"))
    return cloud
