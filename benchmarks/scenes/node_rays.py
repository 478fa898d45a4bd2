# SPDX-License-Identifier: GPL-3.0-or-later
"""Scenes of nodes that trace rays while a material is evaluated, and of wires."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import bpy

from benchmarks.scenes.registry import scene
from benchmarks.scenes.studio import (
    Nodes,
    Socket,
    Surface,
    add_object,
    box,
    camera,
    light,
    material,
    quad,
    resolution,
    show,
    sphere,
    stage,
    world,
)


def _row(surfaces: Sequence[Surface]) -> None:
    """Boxes in a row on the floor, each touching a ball of the same material, and a camera near them."""
    camera((0.0, -4.6, 2.2), (0.0, -0.1, 0.2))
    for index, surface in enumerate(surfaces):
        x = (index - (len(surfaces) - 1) / 2) * 0.8
        made = material(f"surface {index}", surface)
        # Light samples trace no rays of nodes, scattered rays do: what both find depends on the weights of either.
        made.cycles.emission_sampling = "NONE"
        add_object(f"Box {index}", box(f"Box {index}", made, (0.6, 0.6, 0.6)), (x, 0.0, 0.3), (0.0, 0.0, 30.0))
        add_object(f"Ball {index}", sphere(f"Ball {index}", made, 0.25, 24, 12), (x - 0.1, -0.5, 0.25))


def _lit_stage() -> None:
    stage(with_camera=False)
    world((0.5, 0.55, 0.6))
    light("AREA", 200.0, (2.0, -2.0, 4.0), size=4.0)


def _glow(node: Socket, nodes: Nodes) -> Socket:
    return nodes("Emission", Color=node, Strength=1.0)


def _occlusion(properties: dict[str, Any] | None = None, output: str = "AO", **inputs: Any) -> Surface:
    """What an Ambient Occlusion node gives, as emission."""
    return lambda nodes: _glow(nodes("AmbientOcclusion", properties, output=output, **inputs), nodes)


@scene("node-occlusion", samples=16)
def node_occlusion() -> None:
    """Ambient Occlusion nodes: plain, of one object alone, inside, with a colour, with inputs that vary."""
    stage(with_camera=False)
    world((0.5, 0.55, 0.6))

    def varying(nodes: Nodes) -> Socket:
        bent = nodes("Bump", Height=nodes("TexNoise", Scale=6.0), Strength=0.8, Distance=0.3)
        far = nodes("MapRange", Value=nodes("TexChecker", Scale=4.0, output="Fac"), To_Min=0.1, To_Max=2.0)
        return _glow(nodes("AmbientOcclusion", {"samples": 3}, Distance=far, Normal=bent, output="AO"), nodes)

    def as_color(nodes: Nodes) -> Socket:
        shade = nodes("AmbientOcclusion", {"samples": 1}, output="Color", Color=(0.9, 0.5, 0.2), Distance=0.5)
        return nodes("BsdfDiffuse", Color=shade)

    _row([
        _occlusion(), _occlusion({"only_local": True}, Distance=0.4), _occlusion({"inside": True}, Distance=0.3),
        as_color, varying,
    ])  # fmt: skip


@scene("node-bevel", samples=32)
def node_bevel() -> None:
    """Edges rounded by Bevel nodes: shown as normals, glossy, on a bumped surface, over flat and smooth faces."""
    _lit_stage()

    def shown(radius: float, samples: int) -> Surface:
        def surface(nodes: Nodes) -> Socket:
            normal = nodes("Bevel", {"samples": samples}, Radius=radius)
            inputs: dict[int | str, Any] = {0: normal, 1: (0.5, 0.5, 0.5), 2: (0.5, 0.5, 0.5)}
            return _glow(nodes("VectorMath", {"operation": "MULTIPLY_ADD"}, inputs), nodes)

        return surface

    def glossy(nodes: Nodes) -> Socket:
        return nodes("BsdfGlossy", Color=(0.8, 0.7, 0.5), Roughness=0.3, Normal=nodes("Bevel", Radius=0.1))

    def bumped(nodes: Nodes) -> Socket:
        bump = nodes("Bump", Height=nodes("TexNoise", Scale=8.0), Strength=0.5, Distance=0.1)
        return nodes("BsdfDiffuse", Color=(0.7, 0.7, 0.7), Normal=nodes("Bevel", Radius=0.15, Normal=bump))

    _row([shown(0.1, 4), shown(0.3, 1), glossy, bumped])


@scene("node-wireframe", samples=32)
def node_wireframe() -> None:
    """Wires of a width in metres and in pixels, as colour and as bumps."""
    _lit_stage()

    def wires(size: float, in_pixels: bool) -> Surface:
        def surface(nodes: Nodes) -> Socket:
            fac = nodes("Wireframe", {"use_pixel_size": in_pixels}, Size=size)
            return nodes("BsdfDiffuse", Color=nodes("MixRGB", Fac=fac, Color1=(0.1, 0.1, 0.1), Color2=(0.9, 0.6, 0.2)))

        return surface

    def raised(nodes: Nodes) -> Socket:
        bump = nodes("Bump", Height=nodes("Wireframe", Size=0.04), Distance=0.02)
        return nodes("BsdfDiffuse", Color=(0.8, 0.8, 0.8), Normal=bump)

    _row([wires(0.03, False), wires(2.0, True), raised])


@scene("node-rays-moving", samples=32)
def node_rays_moving() -> None:
    """Ambient Occlusion and Bevel nodes on what moves, turns and is mirrored while the shutter is open."""
    stage()
    world((0.5, 0.55, 0.6))
    light("AREA", 100.0, (2.0, -2.0, 4.0), size=4.0)

    def both(nodes: Nodes) -> Socket:
        shade = nodes("AmbientOcclusion", {"samples": 2}, output="Color", Color=(0.8, 0.6, 0.4), Distance=0.6)
        own = nodes("AmbientOcclusion", {"samples": 2, "only_local": True}, output="AO", Distance=0.3)
        color = nodes("MixRGB", Fac=own, Color1=(0.9, 0.1, 0.1), Color2=shade)
        return nodes("BsdfDiffuse", Color=color, Normal=nodes("Bevel", Radius=0.12))

    show(material("both", both))
    moving, turned = bpy.data.objects["Sphere"], bpy.data.objects["Box"]
    turned.scale = (-1.0, 1.3, 0.8)
    for thing, shift in ((moving, 0.4), (turned, 0.0)):
        thing.keyframe_insert("location", frame=0)
        thing.keyframe_insert("rotation_euler", frame=0)
        thing.location.z += shift
        thing.rotation_euler[2] += 0.5
        thing.keyframe_insert("location", frame=2)
        thing.keyframe_insert("rotation_euler", frame=2)
    bpy.context.scene.frame_set(1)
    bpy.context.scene.render.use_motion_blur = True


def _raycast(nodes: Nodes, output: str, properties: dict[str, Any] | None = None, **inputs: Any) -> Socket:
    """An output of a Raycast node; before Blender 5.1, which has none, that of an Ambient Occlusion node."""
    if not hasattr(bpy.types, "ShaderNodeRaycast"):
        return nodes("AmbientOcclusion", properties, output="AO")
    return nodes("Raycast", properties, output=output, **inputs)


def _sampled(nodes: Nodes) -> Socket:
    """Attributes of the floor below: a number chooses between a vector and a colour."""
    if not hasattr(bpy.types, "ShaderNodeRaycast"):
        return _glow(nodes("AmbientOcclusion", output="AO"), nodes)
    node = nodes.node("Raycast", Direction=nodes("CombineXYZ", X=0.2, Y=0.3, Z=-1.0), Length=2.0)
    for kind in ("FLOAT", "VECTOR", "RGBA"):
        node.sample_attribute_items.new(kind, kind)
    names = [socket for socket in node.inputs if socket.type == "STRING"]
    for socket, name in zip(names, ("heat", "UVMap", "tint"), strict=True):
        socket.default_value = name
    heat, where, tint, alpha = (node.outputs[name] for name in ("FLOAT", "VECTOR", "RGBA", "RGBA Alpha"))
    color = nodes("MixRGB", Fac=heat, Color1=where, Color2=tint)
    return nodes("Emission", Color=color, Strength=alpha)


@scene("node-raycast", samples=16)
def node_raycast() -> None:
    """Raycast nodes: how far, where and on what side they hit, in bumps, through the object, and what it has there."""
    stage(with_camera=False)
    world((0.5, 0.55, 0.6))
    floor = bpy.data.objects["Floor"]
    floor.rotation_euler = (0.1, 0.1, 0.0)
    floor.data.attributes.new("heat", "FLOAT", "POINT").data.foreach_set("value", (0.0, 1.0, 0.5, 0.0))
    tints = (1.0, 0.2, 0.1, 1.0, 0.1, 0.9, 0.3, 1.0, 0.2, 0.3, 1.0, 1.0, 0.9, 0.9, 0.2, 0.5)
    floor.data.attributes.new("tint", "FLOAT_COLOR", "CORNER").data.foreach_set("color", tints)

    def down(nodes: Nodes) -> Socket:
        return nodes("CombineXYZ", X=0.2, Y=0.1, Z=-1.0)

    def far(nodes: Nodes) -> Socket:
        return _glow(_raycast(nodes, "Hit Distance", Direction=down(nodes), Length=0.8), nodes)

    def side(nodes: Nodes) -> Socket:
        normal = _raycast(nodes, "Hit Normal", Length=3.0)
        inputs: dict[int | str, Any] = {0: normal, 1: (0.5, 0.5, 0.5), 2: (0.5, 0.5, 0.5)}
        return _glow(nodes("VectorMath", {"operation": "MULTIPLY_ADD"}, inputs), nodes)

    def place(nodes: Nodes) -> Socket:
        where = _raycast(nodes, "Hit Position", Direction=down(nodes), Length=2.0)
        return nodes("BsdfDiffuse", Color=nodes("TexChecker", Vector=where, Scale=8.0))

    def own(nodes: Nodes) -> Socket:
        incoming = nodes("VectorMath", {"operation": "SCALE"}, {0: nodes("NewGeometry", output="Incoming"), 3: -1.0})
        depth = _raycast(nodes, "Hit Distance", {"only_local": True}, Direction=incoming, Length=0.6)
        return _glow(nodes("MixRGB", Fac=_raycast(nodes, "Self Hit"), Color1=depth, Color2=(1.0, 0.0, 0.0)), nodes)

    def bumped(nodes: Nodes) -> Socket:
        height = _raycast(nodes, "Hit Distance", Direction=down(nodes), Length=0.5)
        return nodes("BsdfDiffuse", Color=(0.8, 0.8, 0.8), Normal=nodes("Bump", Height=height, Distance=0.5))

    _row([far, side, place, own, bumped, _sampled])


@scene("node-occlusion-alone", samples=16)
def node_occlusion_alone() -> None:
    """One square, of which nothing can be occluded."""
    resolution()
    world((0.5, 0.5, 0.5))
    camera((0.0, 0.0, 4.0), (0.0, 0.0, 0.0))
    add_object("Square", quad("Square", material("shade", _occlusion())))
