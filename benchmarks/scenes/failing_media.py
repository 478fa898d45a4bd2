# SPDX-License-Identifier: GPL-3.0-or-later
"""Ways in which rendering and guiding media are known to fail, as in `benchmarks.scenes.failures`.

All are small, and half of their light is easy to find: a bias of 2% of the image must be visible after some hundred
thousand paths.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import bpy

from benchmarks.scenes.registry import scene
from benchmarks.scenes.studio import (
    Nodes,
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

WIDTH, HEIGHT = 24, 18
WHITE = (0.75, 0.75, 0.75)


def _begin(ambient: float = 0.2, bounces: int = 6, power: float = 60.0) -> None:
    """A floor under an even sky, and a lamp of so many watts."""
    resolution(WIDTH, HEIGHT)
    world((ambient, ambient, ambient))
    cycles = bpy.context.scene.cycles
    cycles.volume_bounces, cycles.max_bounces = bounces, max(bounces, 12)
    add_object("Floor", quad("Floor", diffuse(WHITE, "floor"), 8.0, 8.0))
    light("AREA", power, (1.6, -0.6, 2.6), (0.0, 0.0, 0.5), size=0.8)
    camera((0.0, -4.2, 1.9), (0.0, 0.0, 0.6), 42.0)


def _fog(density: float, color: Sequence[float] = (0.9, 0.9, 0.9), anisotropy: float = 0.0) -> Any:
    return material(
        "fog", None, lambda nodes: nodes("VolumeScatter", Color=color, Density=density, Anisotropy=anisotropy)
    )


def _ball(surface: Any, radius: float = 0.7, place: Sequence[float] = (0.0, 0.0, 0.75)) -> None:
    add_object("Ball", sphere("Ball", surface, radius), place)


def _box(name: str, surface: Any, size: Sequence[float], place: Sequence[float]) -> None:
    add_object(name, box(name, surface, size), place)


@scene("fail-fog-door", samples=256)
def door() -> None:
    """Fog in two rooms, lit by a lamp in the second alone: its light comes through a door, by fog and by walls."""
    _begin(0.4, 8)
    wall = diffuse(WHITE, "wall")
    for name, size, place in (
        ("Left", (2.2, 0.1, 2.4), (-1.5, 0.4, 1.2)), ("Right", (2.2, 0.1, 2.4), (1.5, 0.4, 1.2)),
        ("Back", (5.2, 0.1, 2.4), (0.0, 2.6, 1.2)), ("Lid", (5.2, 2.3, 0.1), (0.0, 1.5, 2.45)),
    ):  # fmt: skip
        _box(name, wall, size, place)
    _box("Fog", _fog(0.35), (5.0, 5.0, 2.3), (0.0, 0.1, 1.16))
    light("POINT", 60.0, (-1.4, 1.6, 1.8), shadow_soft_size=0.1)


@scene("fail-fog-forward", samples=128)
def forward() -> None:
    """Fog that hardly turns light (g = 0.999): what comes back to the eye came by the narrowest of lobes."""
    _begin(0.6, power=12.0)
    _ball(_fog(2.0, anisotropy=0.999))


@scene("fail-fog-backward", samples=128)
def backward() -> None:
    """Fog that throws all light back (g = -0.999): paths go to and fro on one line."""
    _begin(0.6, power=12.0)
    _ball(_fog(2.0, anisotropy=-0.999))


@scene("fail-fog-thin", samples=128)
def thin() -> None:
    """Fog of density 1e-6, which one path in a million meets: it must neither add light nor take any away."""
    _begin()
    _ball(_fog(1e-6))


@scene("fail-fog-dense", samples=128)
def dense() -> None:
    """Fog of density 1e6: paths end a micrometre inside of it, and every distance is near to rounding."""
    _begin()
    _ball(_fog(1e6))


@scene("fail-fog-albedo", samples=128)
def albedo() -> None:
    """Milk that scatters 99.99% of the light, for 128 bounces: what was learned enters every factor of a path."""
    _begin(0.3, 128)
    _ball(material("milk", None, lambda nodes: nodes(
        "VolumeCoefficients", Scatter_Coefficients=(19.998,) * 3, Absorption_Coefficients=(0.002,) * 3,
    )))  # fmt: skip


@scene("fail-fog-colors", samples=128)
def colors() -> None:
    """Coefficients a hundred times as large in one channel as in another: one distance serves all of them."""
    _begin()
    _ball(material("colors", None, lambda nodes: nodes(
        "VolumeCoefficients", Scatter_Coefficients=(8.0, 0.8, 0.08), Absorption_Coefficients=(0.02, 0.2, 2.0),
    )))  # fmt: skip


@scene("fail-fog-lamp", samples=128)
def lamp() -> None:
    """A small lamp within dense fog, in sight: light falls off with the square of a distance that can be 0."""
    _begin()
    _ball(_fog(1.5))
    light("POINT", 6.0, (0.1, 0.0, 0.8), shadow_soft_size=0.02)


@scene("fail-fog-glass", samples=256)
def glass() -> None:
    """A glass ball in fog, whose caustic lies in the fog itself: paths of scattered rays alone find it."""
    _begin(0.6, power=12.0)
    _box("Fog", _fog(0.25, anisotropy=0.4), (4.0, 3.0, 2.2), (0.0, 0.2, 1.12))
    _ball(material("glass", lambda nodes: nodes("BsdfGlass", Roughness=0.05, IOR=1.5)), 0.5, (0.2, 0.0, 0.9))


@scene("fail-fog-nested", samples=128)
def nested() -> None:
    """64 boxes of thin fog within each other: twice as many as a path keeps account of."""
    _begin(bounces=2)
    thin = _fog(0.02)
    for index in range(64):
        edge = 1.3 - 0.01 * index
        _box(f"Box {index}", thin, (edge, edge, edge), (0.0, 0.0, 0.75))


@scene("fail-fog-coplanar", samples=128)
def coplanar() -> None:
    """Boxes of fog side by side and on each other, on the floor to the last bit: no ray may miss one of two faces."""
    _begin()
    for name, color, place in (
        ("Red", (0.9, 0.3, 0.2), (-0.4, 0.0, 0.4)), ("Blue", (0.2, 0.3, 0.9), (0.4, 0.0, 0.4)),
        ("White", (0.9, 0.9, 0.9), (0.0, 0.0, 1.2)),
    ):  # fmt: skip
        _box(name, _fog(1.0, color), (0.8, 0.8, 0.8), place)


@scene("fail-fog-boundary", samples=128)
def boundary() -> None:
    """A camera in the very face of a box of fog: half of its rays start on either side of rounding."""
    _begin()
    _box("Fog", _fog(0.3), (4.0, 6.2, 4.0), (0.0, -1.1, 2.001))


@scene("fail-fog-huge", samples=128)
def huge() -> None:
    """Thin fog in a box a million times as large as what is seen: its faces lie where positions are metres apart."""
    _begin()
    _box("Fog", _fog(0.03), (4e6, 4e6, 4e6), (0.0, 0.0, 0.0))


def _speck(nodes: Nodes) -> Any:
    """Thin fog but for a speck, 40 times as dense, a fortieth as wide as what it lies in."""
    place = nodes("TexCoord", output="Object")
    distance = nodes("VectorMath", {"operation": "DISTANCE"}, {0: place, 1: (0.21, -0.33, 0.07)}, output="Value")
    inside = nodes("Math", {"operation": "LESS_THAN"}, {0: distance, 1: 0.02})
    density = nodes("Math", {"operation": "MULTIPLY_ADD"}, {0: inside, 1: 7.8, 2: 0.2})
    return nodes("VolumeScatter", Color=(0.9, 0.9, 0.9), Density=density)


@scene("fail-fog-speck", samples=128)
def speck() -> None:
    """A speck in thin fog, 40 times as dense, that bounds of density may have overlooked."""
    _begin()
    _box("Fog", material("speck", None, _speck), (1.6, 1.6, 1.4), (0.0, 0.0, 0.75))


@scene("fail-fog-shreds", samples=128)
def shreds() -> None:
    """Shreds of dense smoke with nothing in between: density varies by all there is within a hand's breadth."""
    _begin()

    def smoke(nodes: Nodes) -> Any:
        noise = nodes("TexNoise", Vector=nodes("TexCoord", output="Object"), Scale=3.0, Detail=3.0)
        above = nodes("Math", {"operation": "SUBTRACT"}, {0: noise, 1: 0.5})
        return nodes("VolumePrincipled", Density=nodes("Math", {"operation": "MULTIPLY"}, {0: above, 1: 120.0}))

    _box("Smoke", material("shreds", None, smoke), (1.8, 1.4, 1.4), (0.0, 0.0, 0.75))
