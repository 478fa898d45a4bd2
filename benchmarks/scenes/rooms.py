# SPDX-License-Identifier: GPL-3.0-or-later
"""A whole room and a glass case, hard in their lighting: what the small scenes are not."""

from __future__ import annotations

import math
from typing import Any

from benchmarks.scenes.registry import scene
from benchmarks.scenes.studio import (
    Nodes,
    Socket,
    add_object,
    box,
    camera,
    diffuse,
    emitter,
    light,
    material,
    mesh,
    quad,
    resolution,
    sphere,
)

#: Noise textures of a weathered wall, one bending the next, and octaves of each: a ray to it costs ten candidates.
_LAYERS, _OCTAVES = 6, 12.0


@scene("evening-room", samples=256)
def evening_room() -> None:
    """A furnished room whose lamps are all out of sight."""
    import bpy

    import addon
    from benchmarks.scenes.interiors.evening_room import build

    addon.register()
    build(256, 144)
    bpy.context.scene.cycles.sample_clamp_indirect = 0.0


@scene("evening-room-fog", samples=256)
def evening_room_fog() -> None:
    """The same room with haze in it, in which the light that comes through the door is seen."""
    import bpy

    import addon
    from benchmarks.scenes.interiors.evening_room import build

    addon.register()
    build(256, 144, is_foggy=True)
    bpy.context.scene.cycles.sample_clamp_indirect = 0.0


@scene("study", samples=256)
def study() -> None:
    """A furnished room that lamps in a cove and behind a door light by way of its ceiling: the demo's."""
    import addon
    from benchmarks.scenes.interiors.study import build

    addon.register()
    build(256, 144, 256)


def _torus(around: int = 96, across: int = 48, radius: float = 0.75, thickness: float = 0.28) -> Any:
    """A diffuse torus about the z axis."""
    vertices = []
    for i in range(around):
        turn = 2.0 * math.pi * i / around
        for k in range(across):
            tilt = 2.0 * math.pi * k / across
            distance = radius + thickness * math.cos(tilt)
            vertices.append((distance * math.cos(turn), distance * math.sin(turn), thickness * math.sin(tilt)))
    faces = [
        (i * across + k, (i + 1) % around * across + k, (i + 1) % around * across + (k + 1) % across,
         i * across + (k + 1) % across)
        for i in range(around)
        for k in range(across)
    ]  # fmt: skip
    created = mesh("Torus", vertices, faces, diffuse((0.8, 0.55, 0.2), "torus"))
    created.polygons.foreach_set("use_smooth", [True] * len(created.polygons))
    return created


@scene("torus-in-glass", samples=1024)
def torus_in_glass() -> None:
    """A torus in a case of glass under a small lamp: all its light has come through the glass."""
    resolution(96, 64)
    camera((0.0, -5.2, 3.0), (0.0, 0.0, 0.65), lens=50.0)
    add_object("Floor", quad("Floor", diffuse((0.5, 0.5, 0.5), "floor"), 8.0, 8.0))
    glass = material("glass", lambda nodes: nodes("BsdfGlass", Color=(1, 1, 1), Roughness=0.0, IOR=1.5))
    add_object("Case", box("Case", glass, (2.6, 2.6, 1.3)), (0.0, 0.0, 0.66))
    add_object("Torus", _torus(), (0.0, 0.0, 0.6), (35, 0, 0))
    add_object("Lamp", sphere("Lamp", emitter((1.0, 0.9, 0.8), 960.0), 0.1, 24, 12), (1.2, -1.0, 3.2))


def _weathered(nodes: Nodes) -> Socket:
    """A wall of many layers of noise."""
    place = nodes("TexCoord", output="Object")
    for layer in range(_LAYERS):
        place = nodes("TexNoise", output="Color", Vector=place, Scale=1.5 + layer, Detail=_OCTAVES)
    return nodes("BsdfDiffuse", Color=place)


@scene("weathered-rooms", samples=256)
def weathered_rooms() -> None:
    """A room lit through the gap in a wall. Shading takes most of the time: candidates are cheap beside it."""
    resolution(96, 64)
    wall = material("weathered", _weathered)
    # Seen from within.
    add_object("Rooms", box("Rooms", wall, (4.0, 7.0, 3.0)), (0.0, 1.5, 1.5))
    for name, middle, width in (("Left", -1.15, 1.7), ("Right", 1.15, 1.7)):
        add_object(name, box(name, wall, (width, 0.1, 3.0)), (middle, 2.0, 1.5))
    add_object("Block", box("Block", diffuse((0.7, 0.7, 0.7), "block"), (0.8, 0.8, 0.8)), (0.9, 0.6, 0.4))
    light("POINT", 400.0, (-1.2, 3.8, 2.4), shadow_soft_size=0.1)
    camera((-1.5, -1.7, 1.6), (0.6, 1.2, 0.9), 24.0)
