# SPDX-License-Identifier: GPL-3.0-or-later
"""Skies of the Sky Texture: its models, its sun high, low, hidden and set, and mixed, moved and on surfaces."""

from __future__ import annotations

import math
from typing import Any

import bpy

from benchmarks.scenes.registry import scene
from benchmarks.scenes.studio import (
    Nodes,
    Socket,
    add_object,
    aim,
    box,
    diffuse,
    material,
    show,
    stage,
    world_nodes,
)


def _outdoors(surface: Any = None, *, up: float = 0.0) -> None:
    """A sphere and a box on the ground, and some sky above them."""
    stage()
    show(surface or diffuse((0.7, 0.6, 0.5)))
    camera = bpy.context.scene.camera
    camera.location = (0.0, -7.0, 1.6)
    aim(camera, (0.0, 0.0, 1.5 + up))


def _sky(nodes: Nodes, kind: str, vector: Any = None, **properties: Any) -> Socket:
    """Colour of a Sky Texture; kinds of single and multiple scattering have another name before Blender 5.0."""
    known = {item.identifier for item in bpy.types.ShaderNodeTexSky.bl_rna.properties["sky_type"].enum_items}
    if kind not in known:
        kind = "NISHITA"
    inputs = {} if vector is None else {"Vector": vector}
    return nodes("TexSky", {"sky_type": kind, **properties}, **inputs)


def _world(kind: str, strength: float = 0.05, **properties: Any) -> None:
    world_nodes(lambda nodes: nodes("Background", Color=_sky(nodes, kind, **properties), Strength=strength))


@scene("sky-multiple", samples=48)
def multiple() -> None:
    """The sky that Blender 5.0 adds, its sun high behind the camera."""
    _outdoors()
    _world("MULTIPLE_SCATTERING", sun_elevation=math.radians(50.0), sun_rotation=math.radians(150.0))


@scene("sky-single", samples=48)
def single() -> None:
    """Single scattering with a large sun of twice the light, dust and ozone, from a mountain."""
    _outdoors()
    _world(
        "SINGLE_SCATTERING", sun_elevation=math.radians(35.0), sun_rotation=math.radians(-120.0), sun_intensity=2.0,
        sun_size=math.radians(4.0), altitude=3000.0, air_density=1.5, aerosol_density=2.0, ozone_density=3.0,
    )  # fmt: skip


@scene("sky-low-sun")
def low_sun() -> None:
    """The sun's disc on the horizon, before the camera, dim enough for its edge not to be all of the noise."""
    _outdoors(up=0.5)
    low = {"sun_elevation": math.radians(2.0), "sun_size": math.radians(6.0), "sun_intensity": 0.01}
    _world("MULTIPLE_SCATTERING", 0.2, **low)


@scene("sky-hidden-sun", samples=32)
def hidden_sun() -> None:
    """A sky without the sun's disc."""
    _outdoors()
    _world("MULTIPLE_SCATTERING", 0.1, sun_disc=False, sun_elevation=math.radians(20.0), sun_rotation=2.0)


@scene("sky-night", samples=32)
def night() -> None:
    """The sun has set."""
    _outdoors()
    _world("MULTIPLE_SCATTERING", 20.0, sun_elevation=math.radians(-5.0), sun_rotation=0.3)


@scene("sky-preetham", samples=32)
def preetham() -> None:
    """Preetham's formula."""
    _outdoors()
    _world("PREETHAM", 0.5, sun_direction=(0.3, 0.5, 0.8124), turbidity=3.5)


@scene("sky-hosek-wilkie", samples=32)
def hosek_wilkie() -> None:
    """Hosek's and Wilkie's formula over bright ground."""
    _outdoors()
    _world("HOSEK_WILKIE", 0.5, sun_direction=(-0.4, 0.6, 0.6928), turbidity=4.3, ground_albedo=0.6)


@scene("sky-mixed")
def mixed() -> None:
    """Two skies in one world, whose suns both shine, and a third that is turned; less of all of it for the camera."""
    _outdoors()

    def surface(nodes: Nodes) -> Socket:
        generated = nodes("TexCoord", output="Generated")
        turned = nodes("Mapping", {"vector_type": "POINT"}, Vector=generated, Rotation=(0.2, 0.0, 1.0))
        first = nodes("Background", Color=_sky(nodes, "MULTIPLE_SCATTERING", sun_size=0.1), Strength=0.1)
        low = _sky(nodes, "SINGLE_SCATTERING", sun_size=0.15, sun_elevation=0.9, sun_rotation=2.0)
        second = nodes("Background", Color=low, Strength=0.1)
        third = nodes("Background", Color=_sky(nodes, "HOSEK_WILKIE", turned), Strength=0.5)
        both = nodes("MixShader", Fac=0.3, inputs={1: first, 2: second})
        shown = nodes("MixShader", Fac=nodes("LightPath", output="Is Camera Ray"), inputs={1: both, 2: third})
        return nodes("AddShader", inputs={0: shown, 1: third})

    world_nodes(surface)


@scene("sky-on-surface", samples=32)
def on_surface() -> None:
    """Surfaces that glow as the sky does, of their generated coordinates."""

    def glow(nodes: Nodes) -> Socket:
        return nodes(
            "Emission", Color=_sky(nodes, "MULTIPLE_SCATTERING", sun_disc=False, sun_elevation=0.7), Strength=0.05
        )

    _outdoors(material("sky", glow))
    world_nodes(lambda nodes: nodes("Background", Color=(0.1, 0.1, 0.1)))


@scene("sky-window", samples=128)
def window() -> None:
    """A room that the sun reaches through a window."""
    stage()
    show(diffuse((0.7, 0.6, 0.5)))
    wall = diffuse((0.8, 0.8, 0.8), "wall")
    for name, size, at in (
        ("back", (8.0, 0.2, 4.0), (0.0, 4.0, 2.0)), ("left", (0.2, 10.0, 4.0), (-4.0, 0.0, 2.0)),
        ("front", (8.0, 0.2, 4.0), (0.0, -9.0, 2.0)), ("roof", (8.4, 14.0, 0.2), (0.0, -2.5, 4.1)),
        ("sill", (0.2, 14.0, 1.0), (4.0, -2.5, 0.5)), ("lintel", (0.2, 14.0, 1.2), (4.0, -2.5, 3.4)),
        ("pillar", (0.2, 4.0, 1.8), (4.0, -6.0, 1.9)), ("side", (0.2, 3.0, 1.8), (4.0, 2.5, 1.9)),
    ):  # fmt: skip
        add_object(name, box(name, wall, size), at)
    _world("MULTIPLE_SCATTERING", 0.2, sun_elevation=math.radians(30.0), sun_rotation=math.radians(90.0))
