# SPDX-License-Identifier: GPL-3.0-or-later
"""One furnished room, lit in three ways that architects' pictures are: by glowing windows, many lamps, or a sky."""

from __future__ import annotations

import math

from benchmarks.scenes.lights import sky_image
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
    quad,
    resolution,
    sphere,
    world_nodes,
)

#: Of the room [m]: x is across, y away from the camera, z up.
_WIDTH, _DEPTH, _HEIGHT, _THICK = 5.0, 6.0, 2.7, 0.2
#: Windows in the left wall: middle along y, and their width, sill and lintel [m].
_WINDOWS, _WINDOW_WIDTH, _SILL, _LINTEL = (-1.2, 1.2), 1.4, 0.8, 2.2


def _block(name: str, surface: object, low: tuple[float, ...], high: tuple[float, ...]) -> None:
    """A box from one corner to the other."""
    size = [b - a for a, b in zip(low, high, strict=True)]
    add_object(name, box(name, surface, size), [(a + b) / 2 for a, b in zip(low, high, strict=True)])


def _shell(has_windows: bool, wall_color: tuple[float, float, float]) -> None:
    """Floor, ceiling, walls, and a left wall of piers, sills and lintels if it has windows."""
    x, y, z, t = _WIDTH / 2, _DEPTH / 2, _HEIGHT, _THICK
    wall = diffuse(wall_color, "wall")
    varnished = {"Base Color": (0.35, 0.2, 0.1, 1.0), "Roughness": 0.35}
    floor = material("floor", lambda nodes: nodes("BsdfPrincipled", **varnished))
    _block("Floor", floor, (-x - t, -y - t, -t), (x + t, y + t, 0.0))
    _block("Ceiling", wall, (-x - t, -y - t, z), (x + t, y + t, z + t))
    _block("Back", wall, (-x - t, y, 0.0), (x + t, y + t, z))
    _block("Behind camera", wall, (-x - t, -y - t, 0.0), (x + t, -y, z))
    _block("Right", wall, (x, -y, 0.0), (x + t, y, z))
    if not has_windows:
        _block("Left", wall, (-x - t, -y, 0.0), (-x, y, z))
        return
    edges = [-y, *(edge for middle in _WINDOWS for edge in (middle - _WINDOW_WIDTH / 2, middle + _WINDOW_WIDTH / 2)), y]
    for start, end in zip(edges[::2], edges[1::2], strict=True):
        _block("Pier", wall, (-x - t, start, 0.0), (-x, end, z))
    for middle in _WINDOWS:
        start, end = middle - _WINDOW_WIDTH / 2, middle + _WINDOW_WIDTH / 2
        _block("Sill", wall, (-x - t, start, 0.0), (-x, end, _SILL))
        _block("Lintel", wall, (-x - t, start, _LINTEL), (-x, end, z))


def _furniture() -> None:
    """A table with things on it, chairs, shelves and a sofa."""
    wood, cloth = diffuse((0.3, 0.16, 0.07), "wood"), diffuse((0.12, 0.2, 0.3), "cloth")
    steel = material("steel", lambda nodes: nodes("BsdfGlossy", Color=(0.8, 0.8, 0.8), Roughness=0.25))
    glass = material("glass", lambda nodes: nodes("BsdfGlass", Color=(1, 1, 1), Roughness=0.0, IOR=1.45))
    _block("Table top", wood, (-0.6, 0.2, 0.72), (1.2, 1.2, 0.76))
    for x in (-0.55, 1.1):
        for y in (0.25, 1.1):
            _block("Leg", wood, (x, y, 0.0), (x + 0.06, y + 0.06, 0.72))
    for x in (-0.2, 0.7):
        _block("Seat", cloth, (x - 0.2, -0.45, 0.42), (x + 0.2, -0.05, 0.47))
        _block("Chair back", wood, (x - 0.2, -0.49, 0.0), (x + 0.2, -0.45, 0.95))
    _block("Sofa", cloth, (-2.3, 2.0, 0.0), (-0.4, 2.9, 0.45))
    _block("Sofa back", cloth, (-2.3, 2.7, 0.45), (-0.4, 2.95, 0.9))
    for row in range(5):
        _block("Shelf", wood, (1.0, 2.6, 0.3 + 0.4 * row), (2.45, 3.0, 0.33 + 0.4 * row))
        for book in range(9):
            green, blue = 0.3 + 0.2 * math.sin(2.0 * book + row), 0.25 + 0.2 * math.cos(3.0 * book)
            cover = diffuse((0.5 + 0.4 * math.sin(book), green, blue), "book")
            left, bottom = 1.05 + 0.15 * book, 0.33 + 0.4 * row
            _block("Book", cover, (left, 2.65, bottom), (left + 0.1, 2.9, bottom + 0.26 + 0.03 * (book % 3)))
    add_object("Bowl", sphere("Bowl", steel, 0.16), (0.0, 0.7, 0.92))
    add_object("Glass", sphere("Glass", glass, 0.12), (0.6, 0.6, 0.88))


def _view() -> None:
    """Camera and settings: all three rooms are the same picture but for their light."""
    resolution(256, 144)
    import bpy

    cycles = bpy.context.scene.cycles
    cycles.max_bounces = cycles.diffuse_bounces = cycles.glossy_bounces = cycles.transmission_bounces = 12
    camera((0.9, -2.8, 1.5), (-0.2, 1.5, 1.0), lens=24.0)


@scene("room-windows", samples=256)
def room_windows() -> None:
    """A furnished room with white walls and glowing windows."""
    _shell(True, (0.8, 0.8, 0.8))
    _furniture()
    for middle in _WINDOWS:
        pane = quad("Pane", emitter((0.8, 0.9, 1.0), 12.0), _LINTEL - _SILL, _WINDOW_WIDTH)
        add_object("Pane", pane, (-_WIDTH / 2 - 0.15, middle, (_SILL + _LINTEL) / 2), (0, 90, 0))
    _view()


@scene("room-kitchen", samples=256)
def room_kitchen() -> None:
    """A furnished room that twenty lamps light, some of them shaded by cupboards."""
    _shell(False, (0.65, 0.6, 0.5))
    _furniture()
    cupboard = diffuse((0.6, 0.6, 0.62), "cupboard")
    _block("Counter", cupboard, (-2.5, -2.4, 0.0), (-1.9, 1.6, 0.9))
    _block("Cupboard", cupboard, (-2.5, -2.4, 1.45), (-2.15, 1.6, 2.2))
    for k in range(8):
        light("POINT", 4.0, (-2.2, -2.1 + 0.5 * k, 1.42), color=(1.0, 0.85, 0.6), shadow_soft_size=0.02)
    for x in (-1.5, 0.0, 1.5):
        for y in (-2.0, 0.0, 2.0):
            place = (x, y, _HEIGHT - 0.02)
            light("SPOT", 25.0, place, (x, y, 0.0), spot_size=math.radians(70.0), shadow_soft_size=0.03)
    for x in (-0.2, 0.3, 0.8):
        add_object("Bulb", sphere("Bulb", emitter((1.0, 0.75, 0.45), 60.0), 0.05, 24, 12), (x, 0.7, 1.7))
    _view()


@scene("room-sky", samples=256)
def room_sky() -> None:
    """A furnished room whose only light is a sky with a sun, through open windows."""
    sky = sky_image(64, 60.0)

    def surface(nodes: Nodes) -> Socket:
        turned = nodes("Mapping", Vector=nodes("TexCoord", output="Generated"), Rotation=(0.0, 0.0, 1.0))
        image = nodes("TexEnvironment", {"image": sky, "projection": "EQUIRECTANGULAR"}, Vector=turned)
        return nodes("Background", Color=image, Strength=4.0)

    _shell(True, (0.7, 0.7, 0.68))
    _furniture()
    world_nodes(surface)
    _view()
