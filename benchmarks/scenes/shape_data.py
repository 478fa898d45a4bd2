# SPDX-License-Identifier: GPL-3.0-or-later
"""What materials read of a mesh's shape, of particles and of menus, and lamps with photometric files."""

from __future__ import annotations

import math
from typing import Any

import bpy
import numpy as np

from benchmarks.scenes.registry import scene
from benchmarks.scenes.studio import (
    Nodes,
    Socket,
    add_object,
    box,
    light,
    lit_stage,
    material,
    mesh,
    show,
    sphere,
    stage,
    world,
)


def _colored(nodes: Nodes, factor: Socket) -> Socket:
    """A diffuse surface in a rainbow of a factor."""
    hue = nodes("CombineColor", {"mode": "HSV"}, Red=factor, Green=0.8, Blue=0.8)
    return nodes("BsdfDiffuse", Color=hue)


@scene("random-per-island", samples=32)
def random_per_island() -> None:
    """Cubes of one mesh, each in a colour of its own."""
    stage()
    world((0.6, 0.6, 0.6))
    surface = material("island", lambda nodes: _colored(nodes, nodes("NewGeometry", output="Random Per Island")))
    corners: list[tuple[float, ...]] = []
    faces: list[tuple[int, ...]] = []
    for k in range(20):
        at = np.array((1.4 * (k % 5) - 2.8, 0.7 * (k // 5) - 1.2, 0.3 + 0.35 * (k // 5)))
        first = len(corners)
        corners += [
            tuple(at + 0.5 * np.array((i, j, h))) for i in (-0.5, 0.5) for j in (-0.5, 0.5) for h in (-0.5, 0.5)
        ]
        sides = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
        faces += [tuple(first + corner for corner in side) for side in sides]
    add_object("Cubes", mesh("Cubes", corners, faces, surface))


@scene("pointiness", samples=32)
def pointiness() -> None:
    """Edges and hollows of a lumpy sphere and of a box."""
    stage()
    world((0.6, 0.6, 0.6))

    def surface(nodes: Nodes) -> Socket:
        sharp = nodes("NewGeometry", output="Pointiness")
        return _colored(nodes, nodes("MapRange", Value=sharp, inputs={1: 0.4, 2: 0.6}))

    lumpy = material("pointy", surface)
    show(lumpy)
    data = bpy.data.objects["Sphere"].data
    for vertex in data.vertices:
        vertex.co *= 1.0 + 0.08 * math.sin(7.0 * vertex.co.x) * math.sin(9.0 * vertex.co.z)
    data.update()


@scene("particle-info", samples=32)
def particle_info() -> None:
    """Boxes at particles, coloured by index, age, size and speed."""
    stage()
    world((0.6, 0.6, 0.6))

    def surface(nodes: Nodes) -> Socket:
        info = nodes.node("ParticleInfo").outputs
        age = nodes("Math", {"operation": "DIVIDE"}, inputs={0: info["Age"], 1: info["Lifetime"]})
        speed = nodes("VectorMath", {"operation": "LENGTH"}, inputs={0: info["Velocity"]}, output="Value")
        place = nodes("Math", {"operation": "MULTIPLY"}, inputs={0: info["Size"], 1: 2.0})
        index = nodes(
            "Math",
            {"operation": "FRACT"},
            inputs={0: nodes("Math", {"operation": "MULTIPLY"}, inputs={0: info["Index"], 1: 0.13})},
        )
        hue = nodes(
            "Math",
            {"operation": "ADD"},
            inputs={0: index, 1: nodes("Math", {"operation": "MULTIPLY"}, inputs={0: speed, 1: 0.02})},
        )
        color = nodes("CombineColor", {"mode": "HSV"}, Red=hue, Green=info["Random"], Blue=place)
        mixed = nodes("MixRGB", {"blend_type": "MULTIPLY"}, Fac=age, Color1=color, Color2=info["Location"])
        return nodes("BsdfDiffuse", Color=mixed)

    item = add_object("Item", box("Item", material("particle", surface), (0.4, 0.4, 0.4)), (0.0, 30.0, 0.0))
    ground = add_object("Source", sphere("Source", material("source", surface), 1.4), (0.0, 0.0, 0.2))
    ground.modifiers.new("Boxes", "PARTICLE_SYSTEM")
    settings: Any = ground.particle_systems[0].settings
    settings.count, settings.render_type, settings.instance_object = 60, "OBJECT", item
    settings.frame_start = settings.frame_end = 1.0
    settings.lifetime, settings.lifetime_random, settings.particle_size, settings.size_random = 50.0, 0.5, 0.5, 0.5
    settings.physics_type = "NEWTON"
    settings.effector_weights.gravity = 0.0
    bpy.context.scene.frame_set(1)


_ANGLES = [0.0, 20.0, 40.0, 60.0, 80.0, 100.0, 180.0]


def _photometry(kind: int, horizontal: list[float], vertical: list[float]) -> str:
    """A luminaire that shines unevenly, as text."""
    rows = [[1000.0 * (1.2 + math.sin(0.05 * h)) * math.exp(-0.02 * abs(v)) for v in vertical] for h in horizontal]
    lines = ["IESNA:LM-63-2002", "TILT=NONE", f"1 1000 1.0 {len(vertical)} {len(horizontal)} {kind} 2 0 0 0", "1 1 50"]
    lines += [" ".join(f"{x:g}" for x in numbers) for numbers in (vertical, horizontal, *rows)]
    return "\n".join(lines) + "\n"


def _luminaire(name: str, kind: str, text: str, location: tuple[float, ...], **properties: Any) -> Any:
    lamp = light(kind, 60.0, location, **properties)
    data = lamp.data
    data.use_nodes = True
    nodes = Nodes(data.node_tree)
    block = bpy.data.texts.new(name)
    block.write(text)
    factor = nodes("TexIES", {"mode": "INTERNAL", "ies": block}, Strength=0.02)
    nodes.node("OutputLight", Surface=nodes("Emission", Strength=factor))
    return lamp


@scene("light-ies")
def ies() -> None:
    """Lamps with photometric files of types A, B and C, one of them turned, one linked to Normal."""
    stage()
    world((0.02, 0.02, 0.03))
    show(material("grey", lambda nodes: nodes("BsdfDiffuse", Color=(0.7, 0.7, 0.7))))
    _luminaire("c", "POINT", _photometry(1, [0.0, 45.0, 90.0], _ANGLES), (-1.5, -1.0, 2.5), shadow_soft_size=0.0)
    lamp = _luminaire("b", "SPOT", _photometry(2, [0.0, 30.0, 60.0, 90.0], [-90.0, -30.0, 0.0, 30.0, 90.0]),
                      (1.5, -1.5, 2.5), shadow_soft_size=0.1, spot_size=2.0)  # fmt: skip
    lamp.rotation_euler = (0.4, 0.3, 0.2)
    lamp = _luminaire("a", "POINT", _photometry(3, [-90.0, -45.0, 0.0, 45.0, 90.0], [-90.0, -45.0, 0.0, 45.0, 90.0]),
                      (0.0, 1.5, 2.5), shadow_soft_size=0.0)  # fmt: skip
    lamp.rotation_euler = (0.2, 0.5, 1.0)
    tree = lamp.data.node_tree
    node = next(node for node in tree.nodes if node.bl_idname == "ShaderNodeTexIES")
    tree.links.new(tree.nodes.new("ShaderNodeTexCoord").outputs["Normal"], node.inputs["Vector"])


@scene("menu-switch", samples=32)
def menu_switch() -> None:
    """A sphere and a box of two choices of a menu, which says to other inputs what it has chosen."""
    lit_stage()

    def choosing(chosen: str) -> Any:
        def surface(nodes: Nodes) -> Socket:
            switch = nodes.tree.nodes.new("GeometryNodeMenuSwitch")
            switch.data_type = "RGBA"
            switch.inputs[0].default_value = chosen
            switch.inputs[1].default_value = (0.8, 0.1, 0.1, 1.0)
            nodes.tree.links.new(nodes("TexChecker", Scale=6.0), switch.inputs[2])
            return nodes("BsdfPrincipled", Base_Color=switch.outputs[0], Metallic=switch.outputs[1])

        return material(f"choice {chosen}", surface)

    add_object("Sphere", sphere("Sphere", choosing("A"), 0.8), (-0.75, 0.0, 0.8))
    add_object("Box", box("Box", choosing("B")), (0.85, -0.2, 0.72), (20, 10, 35))
