# SPDX-License-Identifier: GPL-3.0-or-later
"""Faces in one place: a room whose walls have two layers, as extrusion by nothing leaves, and a rug in its floor."""

from __future__ import annotations

from benchmarks.scenes.registry import scene
from benchmarks.scenes.studio import add_object, box, camera, diffuse, light, mesh, quad, resolution, world

_X, _Y, _TOP = 2.3, 2.1, 1.7


@scene("coincident-faces")
def coincident_faces() -> None:
    """Walls and a rug are black, as they shadow each other; the floor around the rug and the boxes on it are lit."""
    resolution()
    camera((0.4, -6.5, 3.4), (0.0, 0.0, 0.4))
    world((0.5, 0.55, 0.6))
    light("AREA", 150.0, (1.0, -2.0, 4.0), size=3.0)
    grey = diffuse((0.6, 0.6, 0.6), "grey")
    corners = [(-_X, -_Y, 0), (-_X, _Y, 0), (_X, _Y, 0), (-_X, -_Y, _TOP), (-_X, _Y, _TOP), (_X, _Y, _TOP)]
    # The outer layer is lower: its triangles are others.
    corners += [(x, y, 0.7 * _TOP) for x, y, _ in corners[:3]]
    inner, outer = [(0, 1, 4, 3), (1, 2, 5, 4)], [(1, 0, 6, 7), (2, 1, 7, 8)]
    add_object("Walls", mesh("Walls", corners, inner + outer, diffuse((0.7, 0.3, 0.2), "wall")))
    add_object("Floor", quad("Floor", grey, 7.0, 7.0))
    add_object("Rug", quad("Rug", grey, 1.7, 1.3), (-0.3, -1.1, 0.0))
    # Nobody sees where they stand.
    add_object("Box", box("Box", diffuse((0.2, 0.4, 0.7), "blue"), (0.8, 0.8, 0.8)), (0.9, 0.3, 0.4))
    add_object("Other box", box("Other box", grey, (0.6, 0.8, 0.8)), (1.6, 0.3, 0.4))
