# SPDX-License-Identifier: GPL-3.0-or-later
"""Caustics of daily life: light that comes to a surface by way of smooth glass, water or metal.

Suns and lamps have Blender's default size, surfaces are Principled with their default gloss. No light path is cut short
by a limit of its own, and nothing is clamped.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from benchmarks.scenes.caustic_shapes import cut_stone, rounded, turned, wavy
from benchmarks.scenes.registry import scene
from benchmarks.scenes.studio import (
    Nodes,
    Socket,
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

WIDTH, HEIGHT = 128, 96
#: Bounces of every kind.
BOUNCES = 16
#: Blender's default radius of a point lamp [m].
LAMP_RADIUS = 0.1
#: Roughness of the glass of `caustic-rough-*` in hundredths.
ROUGHNESSES = (0, 2, 5, 10, 20)
WATER_IOR, GLASS_IOR = 1.333, 1.5


def _begin(lens: float, location: Sequence[float], target: Sequence[float]) -> None:
    import bpy

    resolution(WIDTH, HEIGHT)
    cycles = bpy.context.scene.cycles
    for kind in ("max", "diffuse", "glossy", "transmission", "transparent_max"):
        setattr(cycles, f"{kind}_bounces", BOUNCES)
    camera(location, target, lens)


def _plain(name: str, color: Sequence[float], **inputs: Any) -> Any:
    """Principled, default gloss."""
    return material(name, lambda nodes: nodes("BsdfPrincipled", Base_Color=color, **inputs))


def _glass(name: str, color: Sequence[float] = (1.0, 1.0, 1.0), roughness: float = 0.0, ior: float = GLASS_IOR) -> Any:
    """Glass as people make it: Principled, all transmission. Its lobes are single scattering's, as GGX has them."""

    def surface(nodes: Nodes) -> Socket:
        inputs = {"Base_Color": color, "Roughness": roughness, "IOR": ior, "Transmission_Weight": 1.0}
        return nodes("BsdfPrincipled", {"distribution": "GGX"}, **inputs)

    return material(name, surface)


WOOD = (0.52, 0.36, 0.24)


def _table(size: float, surface: Any) -> None:
    add_object("Table", quad("Table", surface, size, size))


def _sun(location: Sequence[float], strength: float = 4.0, sky: float = 0.15) -> None:
    """A sun of Blender's default angle that shines from `location` to the origin, and a dim blue sky."""
    light("SUN", strength, location, (0.0, 0.0, 0.0), color=(1.0, 0.93, 0.82))
    world((0.55, 0.7, 1.0), sky)


def _tumbler(table: Any, clear: Any) -> None:
    _begin(50.0, (0.0, -0.5, 0.32), (0.015, -0.03, 0.025))
    _table(1.05, table)
    corners = ((0.0, 0.0), (0.029, 0.0), (0.036, 0.1), (0.0335, 0.1), (0.027, 0.009), (0.0, 0.009))
    add_object("Tumbler", turned("Tumbler", rounded(corners, 0.004), clear), (-0.035, 0.0, 0.0005))
    add_object("Ball", sphere("Ball", clear, 0.028, 128, 64), (0.07, -0.02, 0.0285))
    _sun((-0.7, 1.0, 0.95))


def _simple_glass() -> Any:
    return material("glass", lambda nodes: nodes("BsdfGlass", Color=(1.0, 1.0, 1.0), Roughness=0.0, IOR=GLASS_IOR))


@scene("caustic-glass", samples=1024)
def glass() -> None:
    """A tumbler and a ball of glass on a table in the sun."""
    _tumbler(_plain("table", WOOD), _glass("glass"))


@scene("caustic-glass-matte", samples=1024)
def glass_matte() -> None:
    """The same tumbler and ball on a table without gloss, under no sky: what every renderer means alike."""
    _tumbler(diffuse(WOOD, "table"), _simple_glass())
    world((0.0, 0.0, 0.0))


@scene("caustic-ring", samples=512)
def ring() -> None:
    """A polished gold ring on a table in the sun, which draws a heart into it."""
    _begin(60.0, (0.0, -0.32, 0.3), (0.0, 0.0, 0.0))
    _table(0.45, _plain("table", (0.62, 0.6, 0.56)))
    corners = ((0.05, 0.0), (0.053, 0.0), (0.053, 0.024), (0.05, 0.024))
    gold = _plain("gold", (1.0, 0.77, 0.34), Metallic=1.0, Roughness=0.05)
    add_object("Ring", turned("Ring", rounded(corners, 0.001, is_closed=True), gold, 192, True), (0.0, 0.0, 0.0005))
    _sun((-0.55, 0.6, 0.6))


def _waves(x: float, y: float) -> float:
    """A breeze on water [m]."""
    return 0.012 * math.sin(5.1 * x + 1.7 * y) + 0.009 * math.sin(-3.3 * x + 6.4 * y + 0.7) + 0.006 * math.sin(
        9.0 * x + 4.0 * y + 2.1
    ) + 0.004 * math.sin(2.0 * x - 13.0 * y)  # fmt: skip


def _tiles(nodes: Nodes) -> Socket:
    place = nodes("TexCoord", output="Object")
    colors = {"Color1": (0.62, 0.78, 0.8, 1.0), "Color2": (0.5, 0.7, 0.74, 1.0)}
    return nodes("BsdfPrincipled", Base_Color=nodes("TexChecker", Vector=place, Scale=5.0, inputs=colors))


def _pool(depth: float = 1.3, rim: float = 0.25) -> None:
    x, y = 4.0, 3.0
    tiles = material("tiles", _tiles)
    add_object("Floor", quad("Floor", tiles, x, y), (0.0, 0.0, -depth))
    for name, across, place, turn in (
        ("Left", y, (-x / 2, 0.0), 90.0), ("Right", y, (x / 2, 0.0), -90.0), ("Front", x, (0.0, -y / 2), 180.0),
        ("Back", x, (0.0, y / 2), 0.0),
    ):  # fmt: skip
        add_object(name, quad(name, tiles, across, depth + rim), (*place, 0.5 * (rim - depth)), (90, 0, turn))
    # It ends within the walls, which no light passes.
    water = _glass("water", ior=WATER_IOR)
    add_object("Water", wavy("Water", water, (x + 0.04, y + 0.04), 160, _waves))
    _sun((-0.9, -0.5, 2.0), 5.0, 0.3)


@scene("caustic-pool", samples=512)
def pool() -> None:
    """A pool in the sun, seen from within the water: waves draw bright lines on its floor and walls."""
    _begin(24.0, (-1.5, -1.1, -0.55), (0.8, 0.8, -1.15))
    _pool()


@scene("caustic-pool-above", samples=512)
def pool_above() -> None:
    """The same pool seen from above: its bright lines are seen through the waves that draw them."""
    _begin(28.0, (-0.4, -2.6, 1.9), (0.1, 0.2, -0.8))
    _pool()


def _lamp(roughness: float) -> None:
    _begin(35.0, (0.0, -2.6, 1.15), (0.0, 0.2, 0.55))
    wall = _plain("wall", (0.72, 0.7, 0.66))
    add_object("Floor", quad("Floor", _plain("floor", (0.45, 0.35, 0.27)), 5.0, 5.0))
    add_object("Wall", quad("Wall", wall, 5.0, 3.0), (0.0, 0.85, 1.5), (90, 0, 0))
    count = 24
    arc = [math.pi * k / count for k in range(count + 1)]
    outside = [(0.28 * math.sin(a), -0.26 * math.cos(a)) for a in arc]
    inside = [(0.245 * math.sin(a), -0.245 * math.cos(a)) for a in arc]
    outside[0] = inside[0] = outside[-1] = inside[-1] = (0.0, 0.0)
    poles = ((0.0, -0.26), (0.0, 0.26), (0.0, -0.245), (0.0, 0.245))
    shell = [poles[0], *outside[1:-1], poles[1]]
    hollow = [poles[2], *inside[1:-1], poles[3]]
    frosted = _glass("shade", (1.0, 0.97, 0.92), roughness)

    def ribs(angle: float) -> float:
        return 1.0 + 0.06 * math.cos(10.0 * angle)

    place = (0.1, 0.1, 0.62)
    add_object("Shade", turned("Shade", shell, frosted, 320, swell=ribs), place)
    within = turned("Hollow", hollow, frosted, 192)
    within.flip_normals()
    add_object("Hollow", within, place)
    add_object("Foot", turned("Foot", rounded(((0.0, 0.0), (0.16, 0.0), (0.02, 0.04), (0.02, 0.35), (0.0, 0.35)), 0.01),
                              _plain("foot", (0.05, 0.05, 0.05))), (0.1, 0.1, 0.0))  # fmt: skip
    add_object(
        "Book", box("Book", _plain("book", (0.55, 0.08, 0.06)), (0.3, 0.22, 0.06)), (-0.75, 0.1, 0.031), (0, 0, 20)
    )
    light("POINT", 60.0, place, shadow_soft_size=LAMP_RADIUS, color=(1.0, 0.8, 0.55))
    world((0.0, 0.0, 0.0))


@scene("caustic-lamp", samples=1024)
def lamp() -> None:
    """A lamp inside a ribbed globe of clear glass, the only light: the ribs' pattern is on wall and floor."""
    _lamp(0.0)


@scene("caustic-lamp-frosted", samples=512)
def lamp_frosted() -> None:
    """The same lamp with a globe of frosted glass."""
    _lamp(0.3)


#: Refractive index, Abbe number, colour, radius [m] and place of diamond, ruby, citrine and sapphire.
_STONES = (
    (2.417, 55.3, (1.0, 1.0, 1.0), 0.011, (-0.004, 0.004)), (1.768, 72.2, (1.0, 0.25, 0.25), 0.008, (0.023, 0.014)),
    (1.55, 70.0, (1.0, 0.85, 0.35), 0.009, (-0.028, -0.008)), (1.768, 72.2, (0.3, 0.45, 1.0), 0.006, (0.019, -0.013)),
)  # fmt: skip


def _jewels() -> list[tuple[Any, float]]:
    """The scene; materials of the stones with their Abbe numbers."""
    _begin(100.0, (0.0, -0.19, 0.15), (0.0, -0.001, 0.003))
    _table(0.22, _plain("table", (0.7, 0.68, 0.66)))
    made = []
    for k, (ior, abbe_number, color, radius, place) in enumerate(_STONES):
        stone = _glass("stone", color, ior=ior)
        made.append((stone, abbe_number))
        # Three lie on a face of the pavilion, one on its table.
        tilt = (180, 0, 10) if k == 2 else (50, 0, 40 + 80 * k)
        lowest = radius * 1.206 if k == 2 else 0.0
        item = add_object("Stone", cut_stone("Stone", stone, radius), (*place, lowest + 0.0004), tilt)
        if k != 2:
            item.location.z -= min((item.rotation_euler.to_matrix() @ vertex.co).z for vertex in item.data.vertices)
    _sun((-0.5, 0.75, 0.8))
    return made


@scene("caustic-jewels", samples=1024)
def jewels() -> None:
    """Four cut stones on a light table in the sun."""
    _jewels()


@scene("caustic-jewels-dispersive", samples=1024)
def jewels_dispersive() -> None:
    """The same stones with their dispersion: each spark comes apart into colours."""
    import addon

    addon.register()
    for stone, abbe_number in _jewels():
        stone.neuralguide.dispersion, stone.neuralguide.abbe_number = "ABBE", abbe_number


@scene("caustic-pane", samples=512)
def pane() -> None:
    """A room with sun and sky through a closed window: all of its light has come through a pane of glass."""
    _begin(20.0, (1.25, -1.75, 1.45), (-0.55, 0.7, 0.85))
    x, y, z = 1.6, 2.0, 2.5
    wall = _plain("wall", (0.75, 0.73, 0.69))
    thick = 0.2
    add_object(
        "Floor", box("Floor", _plain("floor", (0.42, 0.27, 0.16)), (2 * x + 0.4, 2 * y + 0.4, thick)), (0, 0, -0.1)
    )
    add_object("Ceiling", box("Ceiling", wall, (2 * x + 0.4, 2 * y + 0.4, thick)), (0, 0, z + 0.1))
    for name, place, size in (
        ("Back", (0.0, y + 0.1), (2 * x, thick)), ("Front", (0.0, -y - 0.1), (2 * x, thick)),
        ("Right", (x + 0.1, 0.0), (thick, 2 * y + 0.4)),
    ):  # fmt: skip
        add_object(name, box(name, wall, (*size, z)), (*place, z / 2))
    # The left wall has a window from 0.9 to 2.1 m, 1.3 m wide.
    low, high, half, middle = 0.9, 2.1, 0.65, 0.5
    for name, first, last, bottom, top in (
        ("Below", middle - half, middle + half, 0.0, low), ("Above", middle - half, middle + half, high, z),
        ("Near", -y - 0.2, middle - half, 0.0, z), ("Far", middle + half, y + 0.2, 0.0, z),
    ):  # fmt: skip
        size = (thick, last - first, top - bottom)
        add_object(name, box(name, wall, size), (-x - 0.1, 0.5 * (first + last), 0.5 * (bottom + top)))
    # Let into the reveal on all sides.
    glazing = box("Pane", _glass("pane"), (0.006, 2 * half + 0.02, high - low + 0.02))
    add_object("Pane", glazing, (-x - 0.12, middle, 0.5 * (low + high)))
    add_object(
        "Chair", box("Chair", _plain("chair", (0.1, 0.25, 0.3)), (0.5, 0.5, 0.45)), (-0.6, 1.2, 0.226), (0, 0, 15)
    )
    light("SUN", 6.0, (-2.4, -0.9, 1.9), (0.0, 0.0, 0.0), color=(1.0, 0.93, 0.82))
    world((0.55, 0.7, 1.0), 0.6)


def _ball(table: Any, clear: Any) -> Any:
    """A ball beside a lamp; returns the lamp."""
    _begin(50.0, (0.0, -1.75, 1.4), (0.03, -0.08, 0.08))
    _table(3.6, table)
    add_object("Ball", sphere("Ball", clear, 0.2, 128, 64), (-0.1, 0.1, 0.2005))
    world((0.55, 0.7, 1.0), 0.02)
    return light("POINT", 60.0, (-1.1, 0.9, 1.3), shadow_soft_size=LAMP_RADIUS, color=(1.0, 0.9, 0.75))


@scene("caustic-ball-matte", samples=1024)
def ball_matte() -> None:
    """A ball of glass on a table without gloss, a sphere as a lamp, no sky: what every renderer means alike."""
    _ball(diffuse((0.5, 0.5, 0.48), "table"), _simple_glass()).data.use_soft_falloff = False
    world((0.0, 0.0, 0.0))


def _register_rough(hundredths: int) -> None:
    def build() -> None:
        _ball(_plain("table", (0.5, 0.5, 0.48)), _glass("glass", roughness=hundredths / 100.0))

    build.__doc__ = f"A ball of glass of roughness {hundredths / 100.0:g} on a table, beside a lamp."
    scene(f"caustic-rough-{hundredths:02d}", samples=1024)(build)


for _hundredths in ROUGHNESSES:
    _register_rough(_hundredths)
