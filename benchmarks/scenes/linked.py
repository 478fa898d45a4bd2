# SPDX-License-Identifier: GPL-3.0-or-later
"""Lamps, suns and glowing meshes that light some objects only, or whose light some objects only cast shadows in."""

from __future__ import annotations

import math
from typing import Any

import bpy

from benchmarks.scenes.light_links import collection, link_light, link_shadows
from benchmarks.scenes.registry import scene
from benchmarks.scenes.studio import (
    add_object,
    box,
    camera,
    diffuse,
    emitter,
    light,
    material,
    quad,
    sphere,
    stage,
    world,
)


def _balls() -> list[Any]:
    """A stage with three balls and a box on it."""
    stage()
    world((0.02, 0.02, 0.03))
    balls = []
    for number, x in enumerate((-1.6, 0.0, 1.6)):
        ball = add_object(f"ball {number}", sphere(f"ball {number}", diffuse((0.7, 0.6, 0.5)), 0.6), (x, 0.2, 0.6))
        balls.append(ball)
    balls.append(add_object("box", box("box", diffuse((0.5, 0.6, 0.7)), (0.8, 0.8, 0.8)), (0.8, -1.2, 0.4)))
    return balls


@scene("linked-receivers")
def receivers() -> None:
    """Lamps of every kind that light some of four objects only, by collections that include, exclude and nest."""
    first, second, third, block = _balls()
    area = light("AREA", 150.0, (-2.0, -2.0, 3.0), size=1.0)
    link_light(area, collection("of area", first, block))
    point = light("POINT", 60.0, (2.5, -1.5, 2.0), shadow_soft_size=0.3)
    link_light(point, collection("of point", excluded=(third,)))
    spot = light("SPOT", 300.0, (0.0, -3.0, 3.0), shadow_soft_size=0.2, spot_size=math.radians(60))
    link_light(spot, collection("of spot", children=(collection("nested", second, third),)))
    sun = light("SUN", 1.0, (2.0, -3.0, 4.0), angle=math.radians(5))
    link_light(sun, collection("of sun", second, excluded=(block,)))
    light("POINT", 40.0, (0.0, 2.0, 2.5), shadow_soft_size=0.1)


@scene("linked-glowing")
def glowing() -> None:
    """Glowing meshes that light some objects only, found by glossy rays, beside a sky that lights everything."""
    first, second, third, block = _balls()
    world((0.1, 0.12, 0.2))
    shiny = material("shiny", lambda nodes: nodes("BsdfAnisotropic", {"distribution": "GGX"}, Roughness=0.25))
    second.data.materials[0] = shiny
    left = add_object("left", quad("left", emitter((1.0, 0.7, 0.4), 12.0), 1.2, 1.2), (-2.2, 0.0, 2.0), (0, 2.2, 0))
    link_light(left, collection("of left", second, block))
    right = add_object("right", quad("right", emitter((0.4, 0.6, 1.0), 12.0), 1.2, 1.2), (2.2, 0.0, 2.0), (0, -2.2, 0))
    link_light(right, collection("of right", excluded=(first, second)))
    del third


@scene("linked-instances")
def instances() -> None:
    """Instances of a collection, which go by what instances them."""
    first, *_ = _balls()
    bpy.context.scene.collection.objects.unlink(first)
    holder = collection("held", first)
    for number, x in enumerate((-1.6, -0.6)):
        empty = add_object(f"empty {number}", None, (x + 1.6, -1.4 + number, 0.0))
        empty.instance_type, empty.instance_collection = "COLLECTION", holder
        if number == 0:
            lamp = light("AREA", 200.0, (-2.0, -2.0, 3.0), size=0.8)
            link_light(lamp, collection("of lamp", empty))
    light("POINT", 30.0, (2.0, -2.0, 3.0), shadow_soft_size=0.2)


@scene("linked-shadows")
def shadows() -> None:
    """Lamps in whose light some objects cast no shadows, one of them transparent."""
    first, second, third, block = _balls()
    clear = material(
        "clear",
        lambda nodes: nodes("MixShader", inputs={0: 0.5, 1: nodes("BsdfTransparent"), 2: nodes("BsdfDiffuse")}),
    )
    third.data.materials[0] = clear
    area = light("AREA", 200.0, (-2.0, -2.0, 3.0), size=0.8)
    link_shadows(area, collection("no shadow", excluded=(first, third)))
    point = light("POINT", 100.0, (2.5, -2.0, 2.5), shadow_soft_size=0.2)
    link_shadows(point, collection("no box", excluded=(block,)))
    sun = light("SUN", 0.6, (2.0, -1.0, 4.0), angle=math.radians(4))
    link_shadows(sun, collection("no ball", excluded=(second,)))
    link_light(sun, collection("lit", excluded=(first,)))


@scene("linked-fog")
def fog() -> None:
    """Haze around balls, lit by lamps that light it or do not."""
    first, *_ = _balls()
    haze = material("haze", None, lambda nodes: nodes("VolumeScatter", Density=0.15))
    cloud = add_object("haze", box("haze", haze, (6.0, 5.0, 3.0)), (0.0, 0.0, 1.55))
    area = light("AREA", 250.0, (-2.0, -2.0, 2.8), size=0.6)
    link_light(area, collection("not the haze", excluded=(cloud,)))
    point = light("POINT", 100.0, (2.0, -1.0, 2.2), shadow_soft_size=0.15)
    link_light(point, collection("the haze", cloud, first))


@scene("linked-rooms", samples=128)
def rooms() -> None:
    """A row of rooms behind walls, each with lamps that are linked to it alone."""
    paint = diffuse((0.7, 0.68, 0.65), "paint")
    world((0.0, 0.0, 0.0))
    count, width = 6, 3.0
    for number in range(count):
        x = width * (number - 0.5 * (count - 1))
        parts = [
            add_object(f"floor {number}", box(f"floor {number}", paint, (width, 4.0, 0.1)), (x, 0.0, -0.05)),
            add_object(f"back {number}", box(f"back {number}", paint, (width, 0.1, 3.0)), (x, 2.0, 1.5)),
            add_object(f"side {number}", box(f"side {number}", paint, (0.1, 4.0, 3.0)), (x - 0.5 * width, 0.0, 1.5)),
            add_object(f"thing {number}", sphere(f"thing {number}", diffuse((0.6, 0.5, 0.4)), 0.5), (x, 0.3, 0.5)),
        ]
        own = collection(f"room {number}", *parts)
        for side in (-0.7, 0.7):
            lamp = light("AREA", 25.0, (x + side, -0.4, 2.7), size=0.4)
            lamp.rotation_euler = (0.0, 0.0, 0.0)
            link_light(lamp, own)
    camera((0.0, -9.0, 2.2), (0.0, 0.5, 1.2), lens=26.0)
