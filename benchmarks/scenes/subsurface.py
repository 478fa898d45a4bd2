# SPDX-License-Identifier: GPL-3.0-or-later
"""Light that goes in below surfaces: skin, stone, milk and wax."""

from __future__ import annotations

from typing import Any

import bpy

from benchmarks.scenes.closures import closure_scene
from benchmarks.scenes.registry import scene
from benchmarks.scenes.studio import (
    Nodes,
    Socket,
    Surface,
    add_object,
    box,
    light,
    lit_stage,
    material,
    mesh,
    sphere,
    stage,
    world,
)

SKIN = (1.0, 0.35, 0.2)


def walk(name: str = "RANDOM_WALK") -> dict[str, Any]:
    """Settings of the Subsurface Scattering node."""
    return {"falloff": name}


@closure_scene("subsurface-walk", samples=128)
def random_walk(nodes: Nodes) -> Socket:
    """Subsurface Scattering by a random walk, whose colours go differently far."""
    return nodes("SubsurfaceScattering", walk(), Color=(0.8, 0.5, 0.3), Radius=SKIN, Scale=0.5)


@closure_scene("subsurface-anisotropic", samples=128)
def anisotropic(nodes: Nodes) -> Socket:
    """A random walk that mostly goes on forwards, entered through a smooth surface."""
    return nodes(
        "SubsurfaceScattering", walk(), Color=(0.8, 0.7, 0.6), Radius=SKIN, Scale=0.5, Anisotropy=0.7, Roughness=0.1
    )


@closure_scene("subsurface-skin", samples=128)
def skin(nodes: Nodes) -> Socket:
    """The Principled BSDF's skin, half of it diffuse, under its dielectric."""
    return nodes(
        "BsdfPrincipled", {"subsurface_method": "RANDOM_WALK_SKIN"}, Base_Color=(0.8, 0.45, 0.35), Roughness=0.4,
        Subsurface_Weight=0.7, Subsurface_Radius=SKIN, Subsurface_Scale=0.2, Subsurface_Anisotropy=0.8,
    )  # fmt: skip


@closure_scene("subsurface-burley", samples=256)
def burley(nodes: Nodes) -> Socket:
    """Burley's profile."""
    return nodes("SubsurfaceScattering", walk("BURLEY"), Color=(0.7, 0.6, 0.3), Radius=SKIN, Scale=0.5)


@closure_scene("subsurface-bumped", samples=128)
def bumped(nodes: Nodes) -> Socket:
    """A random walk, with bumps where light comes out, mixed with a glossy lobe."""
    height = nodes("TexNoise", Scale=6.0, output="Fac")
    bumps = nodes("Bump", Height=height, Strength=0.6)
    below = nodes("SubsurfaceScattering", walk(), Color=(0.7, 0.7, 0.8), Radius=SKIN, Scale=0.3, Normal=bumps)
    above = nodes("BsdfAnisotropic", Color=(0.9, 0.9, 0.9), Roughness=0.3, Normal=bumps)
    return nodes("MixShader", inputs={0: 0.25, 1: below, 2: above})


def _head(surface: Surface, size: float = 1.6) -> Any:
    """Suzanne, whose ears are thin."""
    bpy.ops.mesh.primitive_monkey_add(size=size, location=(0.0, 0.0, 0.85))
    head = bpy.context.object
    head.data.polygons.foreach_set("use_smooth", [True] * len(head.data.polygons))
    head.data.materials.append(material("Skin", surface))
    return head


def _milk(nodes: Nodes) -> Socket:
    return nodes("SubsurfaceScattering", walk(), Color=(0.95, 0.92, 0.85), Radius=(1.0, 0.8, 0.6), Scale=0.5)


@scene("subsurface-ears", samples=128)
def ears() -> None:
    """A head before a lamp, which shines through its ears."""
    stage()
    _head(skin)
    light("AREA", 300.0, (0.0, 3.0, 2.5), size=1.0)
    world((0.1, 0.1, 0.12))


@scene("subsurface-wax", samples=256)
def wax() -> None:
    """A candle of wax around a lamp, which only its inside sees."""
    stage()
    surface = material("Wax", _milk)
    add_object("Candle", sphere("Candle", surface, 0.7), (0.0, 0.0, 0.9))
    light("POINT", 200.0, (0.2, 0.0, 1.0), shadow_soft_size=0.1)
    world((0.05, 0.05, 0.05))


@scene("subsurface-instances", samples=128)
def instances() -> None:
    """Marble boxes of one mesh, stretched, mirrored, and moved through each other."""
    lit_stage()
    shared = box("Box", material("Marble", _milk), (0.9, 0.9, 0.9))
    for number, (place, scale) in enumerate(
        [((-0.9, 0.0, 0.6), (1.0, 1.0, 1.0)), ((0.3, 0.2, 0.6), (0.6, 1.2, -1.1)), ((0.7, -0.3, 0.7), (0.8, 0.8, 1.4))]
    ):
        add_object(f"Box {number}", shared, place, (10.0, 20.0 * number, 30.0)).scale = scale


@scene("subsurface-open", samples=128)
def open_mesh() -> None:
    """A bent leaf without an inside, which most walks never leave."""
    lit_stage()
    rows = [(-1.0, 0.4), (-0.5, 0.8), (0.0, 1.0), (0.5, 0.8), (1.0, 0.4)]
    points = [(x, y, z) for x, z in rows for y in (-0.7, 0.7)]
    faces = [(2 * k, 2 * k + 2, 2 * k + 3, 2 * k + 1) for k in range(len(rows) - 1)]
    add_object("Leaf", mesh("Leaf", points, faces, material("Leaf", _milk)))
