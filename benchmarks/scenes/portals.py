# SPDX-License-Identifier: GPL-3.0-or-later
"""Rooms that a world lights through openings with light portals."""

from __future__ import annotations

import math
from typing import Any

import bpy

from benchmarks.scenes.lights import sky_image
from benchmarks.scenes.registry import scene
from benchmarks.scenes.studio import (
    Nodes,
    Socket,
    add_object,
    box,
    camera,
    diffuse,
    mesh,
    resolution,
    show,
    world,
    world_nodes,
)

#: Half the size of the room in x and y, its height [m].
_HALF, _HEIGHT = 2.5, 2.6


def _frame(name: str, outer: Any, inner: Any, to_3d: Any, surface: Any) -> None:
    """A wall with a rectangular hole; `outer` and `inner` are (left, bottom, right, top) in its plane."""
    corners = []
    for left, bottom, right, top in (outer, inner):
        corners += [(left, bottom), (right, bottom), (right, top), (left, top)]
    faces = [(0, 1, 5, 4), (1, 2, 6, 5), (2, 3, 7, 6), (3, 0, 4, 7)]
    add_object(name, mesh(name, [to_3d(*corner) for corner in corners], faces, surface))


def _portal(location: Any, rotation: Any, **shape: Any) -> None:
    data = bpy.data.lights.new("Portal", "AREA")
    for name, value in shape.items():
        setattr(data, name, value)
    data.cycles.is_portal = True
    add_object("Portal", data, location).rotation_euler = [math.radians(angle) for angle in rotation]


def _room() -> None:
    """A closed room with a small window in its left wall and a hole in its ceiling."""
    resolution(64, 48)
    h = _HALF
    walls = diffuse((0.75, 0.72, 0.68), "walls")
    for name, corners in {
        "Floor": [(-h, -h, 0), (h, -h, 0), (h, h, 0), (-h, h, 0)],
        "Back": [(-h, h, 0), (h, h, 0), (h, h, _HEIGHT), (-h, h, _HEIGHT)],
        "Front": [(-h, -h, 0), (h, -h, 0), (h, -h, _HEIGHT), (-h, -h, _HEIGHT)],
        "Right": [(h, -h, 0), (h, h, 0), (h, h, _HEIGHT), (h, -h, _HEIGHT)],
    }.items():
        add_object(name, mesh(name, corners, [(0, 1, 2, 3)], walls))
    _frame("Left", (-h, 0.0, h, _HEIGHT), (0.2, 1.0, 1.2, 1.8), lambda y, z: (-h, y, z), walls)
    _frame("Ceiling", (-h, -h, h, h), (0.6, -0.4, 1.4, 0.4), lambda x, y: (x, y, _HEIGHT), walls)
    show(diffuse((0.6, 0.5, 0.4)))
    add_object("Sill", box("Sill", walls, (0.3, 1.2, 0.05)), (-h + 0.15, 0.7, 0.95))
    camera((0.9, -2.3, 1.6), (-0.5, 0.6, 0.9), lens=22.0)
    _portal((-h, 0.7, 1.4), (90, 0, -90), shape="RECTANGLE", size=1.0, size_y=0.8)
    _portal((1.0, 0.0, _HEIGHT), (0, 0, 0), shape="DISK", size=0.8)


@scene("portals-uniform", samples=256)
def uniform() -> None:
    """A room under a white sky, by a rectangular portal and a round one."""
    _room()
    world((0.9, 1.0, 1.1), 3.0)


@scene("portals-sky", samples=256)
def sky() -> None:
    """The same room under an image with a bright place."""
    _room()
    picture = sky_image(64, 30.0)

    def surface(nodes: Nodes) -> Socket:
        turned = nodes("Mapping", Vector=nodes("TexCoord", output="Generated"), Rotation=(0.0, 0.0, 1.2))
        return nodes("Background", Color=nodes("TexEnvironment", {"image": picture}, Vector=turned), Strength=2.0)

    world_nodes(surface)
