# SPDX-License-Identifier: GPL-3.0-or-later
"""Media that some lamps light, or that cast no shadows in their light, alone and where they overlap; linked fire."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import bpy

from benchmarks.scenes.light_links import collection, link_light, link_shadows
from benchmarks.scenes.registry import scene
from benchmarks.scenes.studio import Nodes, add_object, box, diffuse, light, material, sphere, stage, world, world_nodes

Shader = Callable[[Nodes], Any]


def _scatter(density: float, color: tuple[float, float, float] = (0.9, 0.9, 0.9)) -> Shader:
    return lambda nodes: nodes("VolumeScatter", Color=color, Density=density)


def _patches(density: float) -> Shader:
    """Fog that is up to twice as dense as said, and nothing elsewhere."""

    def make(nodes: Nodes) -> Any:
        spread = nodes("Math", {"operation": "MULTIPLY"}, {0: nodes("TexNoise", Scale=1.5), 1: 2.0 * density})
        return nodes("VolumeScatter", Density=spread)

    return make


def _place(name: str, inside: Shader, size: tuple[float, float, float], at: tuple[float, float, float]) -> Any:
    return add_object(name, box(name, material(name, None, inside), size), at)


def _ball(x: float) -> Any:
    stage()
    world((0.0, 0.0, 0.0))
    bpy.context.scene.cycles.volume_bounces = 3
    return add_object("ball", sphere("ball", diffuse((0.7, 0.6, 0.5)), 0.5), (x, 0.0, 0.5))


@scene("linked-fog-overlapping", samples=128)
def overlapping() -> None:
    """Two fogs that share a part of space, lit by lamps that are for one of them, for the other, or for both."""
    ball = _ball(-1.6)
    warm = _place("warm", _scatter(0.5, (0.9, 0.6, 0.4)), (2.4, 2.6, 1.6), (-0.5, 0.0, 0.9))
    cold = _place("cold", _scatter(0.5, (0.4, 0.6, 0.9)), (2.4, 1.4, 1.3), (0.6, 0.1, 0.9))
    first = light("AREA", 120.0, (-2.0, -2.0, 3.0), size=0.6)
    link_light(first, collection("warm and ball", warm, ball))
    second = light("POINT", 80.0, (2.0, -2.0, 2.6), shadow_soft_size=0.2)
    link_light(second, collection("no warm", excluded=(warm,)))
    third = light("SUN", 0.5, (1.0, 2.0, 4.0), angle=0.1)
    link_light(third, collection("both", warm, cold))


@scene("linked-fog-world", samples=128)
def in_the_world_s() -> None:
    """A cloud, here and there thick, in the world's fog, with lamps that light neither, one, or both."""
    ball = _ball(-1.2)
    world_nodes(None, _scatter(0.04))
    cloud = _place("cloud", _patches(0.8), (1.6, 1.6, 1.4), (0.7, 0.0, 0.9))
    first = light("AREA", 120.0, (-2.0, -2.0, 3.0), size=0.6)
    link_light(first, collection("no cloud", excluded=(cloud,)))
    second = light("POINT", 80.0, (2.0, -2.0, 2.6), shadow_soft_size=0.2)
    link_light(second, collection("cloud alone", cloud))
    third = light("POINT", 40.0, (0.0, 1.6, 2.4), shadow_soft_size=0.2)
    link_light(third, collection("no ball", excluded=(ball,)))


@scene("linked-fire", samples=128)
def fire() -> None:
    """A fire that lights a ball only, so that no camera sees it, one that lights all else, and smoke through both."""
    ball = _ball(0.0)

    def glow(color: tuple[float, float, float]) -> Shader:
        return lambda nodes: nodes("Emission", Color=color, Strength=1.5)

    hidden = _place("hidden", glow((0.3, 0.6, 1.0)), (0.8, 0.8, 0.8), (-1.2, -0.3, 0.6))
    seen = _place("seen", glow((1.0, 0.5, 0.2)), (0.8, 0.8, 0.8), (1.2, -0.3, 0.6))
    link_light(hidden, collection("ball", ball))
    link_light(seen, collection("no ball", excluded=(ball,)))
    _place("smoke", _scatter(0.6), (3.6, 0.5, 0.5), (0.0, -0.3, 0.9))


@scene("linked-shadows-media", samples=128)
def shadows() -> None:
    """Ink that dims some lamps' light alone, over a floor; half of it is thick in patches."""
    _ball(0.0)

    def ink(color: tuple[float, float, float]) -> Shader:
        return lambda nodes: nodes("VolumeAbsorption", Color=color, Density=2.0)

    def clouded(nodes: Nodes) -> Any:
        spread = nodes("Math", {"operation": "MULTIPLY"}, {0: nodes("TexNoise", Scale=2.0), 1: 5.0})
        return nodes("VolumeAbsorption", Color=(0.2, 0.3, 0.8), Density=spread)

    red = _place("red", ink((0.9, 0.2, 0.1)), (1.2, 1.2, 0.5), (-1.1, -0.6, 1.3))
    blue = _place("blue", clouded, (1.2, 1.2, 0.5), (1.1, -0.6, 1.3))
    point = light("POINT", 120.0, (0.0, -0.8, 3.0), shadow_soft_size=0.2)
    link_shadows(point, collection("no red", excluded=(red,)))
    sun = light("SUN", 1.0, (0.5, -1.0, 4.0), angle=0.05)
    link_shadows(sun, collection("no blue", excluded=(blue,)))
    light("AREA", 60.0, (0.0, 1.5, 3.0), size=0.8)
