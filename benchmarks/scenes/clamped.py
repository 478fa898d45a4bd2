# SPDX-License-Identifier: GPL-3.0-or-later
"""Rooms of whose light Blender's default clamp takes much: few bright paths bring it."""

from __future__ import annotations

from benchmarks.scenes.registry import scene
from benchmarks.scenes.studio import (
    add_object,
    box,
    camera,
    diffuse,
    light,
    material,
    quad,
    resolution,
    sphere,
    world,
)

#: Of the room [m].
_WIDTH, _DEPTH, _HEIGHT = 4.0, 5.0, 2.6


def _room() -> None:
    """A white room with a red wall, and a table, a blue box and a metal ball in it; no light."""
    white = diffuse((0.8, 0.8, 0.8), "white")
    add_object("Room", box("Room", white, (_WIDTH, _DEPTH, _HEIGHT)), (0.0, 0.0, 0.5 * _HEIGHT))
    red = quad("Red", diffuse((0.6, 0.2, 0.15), "red"), _DEPTH, _HEIGHT)
    add_object("Red", red, (0.01 - 0.5 * _WIDTH, 0.0, 0.5 * _HEIGHT), (90, 0, 90))
    wood = material("wood", lambda nodes: nodes("BsdfPrincipled", Base_Color=(0.4, 0.25, 0.15), Roughness=0.4))
    add_object("Table", box("Table", wood, (1.4, 0.8, 0.06)), (0.3, 0.8, 0.75))
    add_object("Box", box("Box", diffuse((0.2, 0.4, 0.7), "blue"), (0.5, 0.5, 0.9)), (-1.2, 1.5, 0.45), (0, 0, 25))
    metal = material(
        "metal", lambda nodes: nodes("BsdfPrincipled", Base_Color=(0.8, 0.8, 0.8), Metallic=1.0, Roughness=0.25)
    )
    add_object("Ball", sphere("Ball", metal, 0.25), (0.4, 0.8, 1.03))
    resolution(96, 54)
    camera((0.2, -2.3, 1.4), (0.0, 1.0, 1.1), 22.0)


@scene("clamped-ceiling-lamp", samples=256)
def clamped_ceiling_lamp() -> None:
    """A room whose lamp shines upwards, 10 cm under a white ceiling."""
    _room()
    light("AREA", 60.0, (0.0, 0.3, _HEIGHT - 0.1), (0.0, 0.3, _HEIGHT + 1.0), size=0.2)


@scene("clamped-sun-gap", samples=256)
def clamped_sun_gap() -> None:
    """A closed room, and a sun that shines through a gap in its ceiling upon the floor."""
    resolution(96, 54)
    white = diffuse((0.8, 0.8, 0.8), "white")
    for name, size, place in (
        ("Floor", (4.0, 5.0, 0.1), (0.0, 0.0, -0.05)),
        ("Left", (0.1, 5.0, 2.6), (-2.05, 0.0, 1.3)),
        ("Right", (0.1, 5.0, 2.6), (2.05, 0.0, 1.3)),
        ("Back", (4.2, 0.1, 2.6), (0.0, 2.55, 1.3)),
        ("Front", (4.2, 0.1, 2.6), (0.0, -2.55, 1.3)),
        ("Ceiling left", (2.1, 5.2, 0.1), (-1.15, 0.0, 2.65)),
        ("Ceiling right", (2.1, 5.2, 0.1), (1.15, 0.0, 2.65)),
    ):
        add_object(name, box(name, white, size), place)
    add_object("Box", box("Box", diffuse((0.2, 0.4, 0.7), "blue"), (0.5, 0.5, 0.9)), (-1.2, 1.5, 0.45), (0, 0, 25))
    light("SUN", 1000.0, (0.0, 0.0, 5.0), (0.15, 0.0, 0.0), angle=0.01)
    camera((0.2, -2.3, 1.4), (0.0, 1.0, 1.1), 22.0)


@scene("clamped-caustic", samples=256)
def clamped_caustic() -> None:
    """A wall on which a small bright lamp throws the caustic of a mirror that hides it, under a dim world."""
    resolution(96, 54)
    world((0.05, 0.06, 0.08))
    add_object("Floor", quad("Floor", diffuse((0.6, 0.6, 0.6), "floor"), 8.0, 8.0))
    add_object("Wall", quad("Wall", diffuse((0.7, 0.7, 0.65), "wall"), 8.0, 5.0), (0.0, 2.0, 2.5), (90, 0, 0))
    mirror = material("mirror", lambda nodes: nodes("BsdfGlossy", Color=(0.9, 0.9, 0.9), Roughness=0.1))
    add_object("Mirror", sphere("Mirror", mirror, 0.6), (-0.9, 0.6, 0.6))
    light("AREA", 300.0, (1.2, 0.0, 1.6), (-0.9, 0.6, 0.6), size=0.15)
    camera((0.0, -5.0, 2.0), (0.0, 1.0, 1.1), 35.0)
