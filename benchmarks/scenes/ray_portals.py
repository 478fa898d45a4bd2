# SPDX-License-Identifier: GPL-3.0-or-later
"""Ray portals: surfaces behind which rays go on from another place."""

from __future__ import annotations

from benchmarks.scenes.registry import scene
from benchmarks.scenes.studio import Nodes, Socket, add_object, diffuse, light, material, quad, sphere, stage, world


def _halls() -> None:
    """The stage and another floor 20 m apart, each with a ball and a lamp under a dim sky."""
    stage()
    world((0.1, 0.12, 0.15))
    add_object("There", quad("There", diffuse((0.7, 0.6, 0.4)), 12.0, 12.0), (20.0, 0.0, 0.0))
    for x, color, energy in ((0.0, (0.2, 0.4, 0.8), 100.0), (20.0, (0.9, 0.4, 0.1), 300.0)):
        add_object("Ball", sphere("Ball", diffuse(color), 0.5), (x + 1.0, -0.2, 0.5))
        light("AREA", energy, (x + 2.0, -2.0, 4.0), size=1.5)


@scene("ray-portal", samples=128)
def ray_portal() -> None:
    """A tinted portal upright in one hall, through which cameras and light see the other."""
    _halls()

    def surface(nodes: Nodes) -> Socket:
        position = nodes("NewGeometry", output="Position")
        there = nodes("VectorMath", {"operation": "ADD"}, {0: position, 1: (21.2, -0.2, 0.0)})
        return nodes("BsdfRayPortal", Color=(0.9, 1.0, 0.8), Position=there)

    add_object("Portal", quad("Portal", material("portal", surface), 1.8, 1.8), (-0.9, 0.6, 1.0), (90.0, 0.0, 15.0))


@scene("ray-portal-mixed", samples=128)
def ray_portal_mixed() -> None:
    """A wall that is half a diffuse surface, and half lets rays go on from where they are, upwards and back."""
    _halls()

    def surface(nodes: Nodes) -> Socket:
        normal = nodes("NewGeometry", output="Normal")
        direction = nodes("VectorMath", {"operation": "ADD"}, {0: normal, 1: (0.6, 0.2, -0.5)})
        unit = nodes("VectorMath", {"operation": "NORMALIZE"}, {0: direction})
        portal = nodes("BsdfRayPortal", Color=(1.0, 0.9, 0.7), Direction=unit)
        wall = nodes("BsdfDiffuse", Color=(0.3, 0.6, 0.3))
        return nodes("MixShader", {}, {0: 0.5, 1: wall, 2: portal})

    add_object("Wall", quad("Wall", material("wall", surface), 2.0, 2.0), (-0.9, 0.8, 1.0), (90.0, 0.0, 15.0))
