# SPDX-License-Identifier: GPL-3.0-or-later
"""Hair, skin, stone, grass, sand and points in rooms whose lamps are out of sight: where guiding is judged."""

from __future__ import annotations

from benchmarks.scenes.displaced import displaced, grid, noise
from benchmarks.scenes.matter import bust, haired_head, rug, statues
from benchmarks.scenes.plants import grass
from benchmarks.scenes.registry import scene
from benchmarks.scenes.studio import Nodes, Socket, add_object, box, camera, diffuse, light, resolution, world
from benchmarks.scenes.walls import shell, wall_with_hole

_WALL = (0.75, 0.73, 0.7)


def _begin() -> None:
    resolution()
    world((0.0, 0.0, 0.0))
    camera((-0.6, -3.2, 1.5), (0.0, 0.2, 0.8), 30.0)


def _door() -> None:
    """A room that a lamp in the next one lights, through a doorway."""
    _begin()
    shell("Room", diffuse(_WALL, "room"), (-2, -3.4, 0), (2, 2, 2.6), "Y")
    shell("Next", diffuse((0.85, 0.8, 0.72), "next"), (-2, 2, 0), (2, 5, 2.6), "y")
    wall_with_hole("Wall", diffuse((0.6, 0.6, 0.65), "wall"), 2.0, (1.0, 1.6, 0.001, 2.0), 2.0, 2.6)
    light("POINT", 900.0, (-1.2, 3.6, 2.0), shadow_soft_size=0.15)


def _cove() -> None:
    """A room that lamps light by way of its ceiling, from behind a moulding along its back wall."""
    _begin()
    shell("Room", diffuse(_WALL, "room"), (-2, -3.4, 0), (2, 2, 2.6))
    add_object("Moulding", box("Moulding", diffuse(_WALL, "moulding"), (4.0, 0.05, 0.3)), (0.0, 1.7, 2.15))
    add_object("Ledge", box("Ledge", diffuse(_WALL, "ledge"), (4.0, 0.3, 0.04)), (0.0, 1.85, 2.02))
    light("AREA", 250.0, (0.0, 1.87, 2.1), (0.0, 1.87, 9.0), shape="RECTANGLE", size=3.6, size_y=0.1)


@scene("door-head", samples=256)
def door_head() -> None:
    """A head of skin and hair in a room lit through a doorway."""
    _door()
    haired_head(2000, 0.02)


@scene("door-statues", samples=256)
def door_statues() -> None:
    """Marble and milk in a room lit through a doorway."""
    _door()
    statues(1, (0.0, 0.3))


@scene("door-meadow", samples=256)
def door_meadow() -> None:
    """A room grown over with grass, lit through a doorway."""
    _door()
    grass(4000, 60, (1.95, 1.9))


@scene("cove-rug", samples=256)
def cove_rug() -> None:
    """A hairy rug in a room lit from a cove."""
    _cove()
    rug(2000, 0.03)


@scene("cove-sand", samples=256)
def cove_sand() -> None:
    """Sand that has blown into a room lit from a cove."""
    _cove()

    def heights(nodes: Nodes) -> Socket:
        return nodes("Displacement", Height=noise(nodes, "Object", 1.2, 3.0), Midlevel=0.0, Scale=0.9)

    add_object("Sand", grid("Sand", displaced(heights, "BOTH", (0.8, 0.6, 0.35)), 5.3, 96), (0.0, -0.7, -0.3))


@scene("cove-bust", samples=256)
def cove_bust() -> None:
    """A head of points in a room lit from a cove."""
    _cove()
    bust(3000, 0.03)
