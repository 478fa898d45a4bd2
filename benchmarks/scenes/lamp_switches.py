# SPDX-License-Identifier: GPL-3.0-or-later
"""What lamps have besides shape and strength: switches of their light, and how they look where a camera sees them."""

from __future__ import annotations

import math
from typing import Any

import bpy
from mathutils import Matrix

from benchmarks.scenes.lights import dim_stage
from benchmarks.scenes.registry import scene
from benchmarks.scenes.studio import add_object, diffuse, light, material, show, sphere


def _switched(lamp: Any, **settings: Any) -> None:
    """Set what Cycles alone has of a lamp."""
    for name, value in settings.items():
        setattr(lamp.data.cycles, name, value)


@scene("lamp-switches", samples=128)
def switches() -> None:
    """Lamps without multiple importance sampling, without bounces, without shadows, and hidden from kinds of rays."""
    dim_stage()
    glass = material("glass", lambda nodes: nodes("BsdfGlass", {"distribution": "GGX"}, Roughness=0.3, IOR=1.4))
    glossy = material("shiny", lambda nodes: nodes("BsdfAnisotropic", {"distribution": "GGX"}, Roughness=0.3))
    add_object("glass", sphere("glass", glass, 0.4), (-1.3, -1.4, 0.4))
    add_object("shiny", sphere("shiny", glossy, 0.4), (1.3, -1.4, 0.4))
    alone = light("AREA", 60.0, (-2.5, -1.0, 2.5), color=(1.0, 0.6, 0.4), size=1.0)
    _switched(alone, use_multiple_importance_sampling=False)
    direct = light("POINT", 60.0, (2.0, -2.0, 2.5), color=(0.4, 1.0, 0.6), shadow_soft_size=0.2)
    _switched(direct, max_bounces=0)
    light("SPOT", 100.0, (0.0, -2.5, 3.0), color=(0.5, 0.6, 1.0), shadow_soft_size=0.3, use_shadow=False)
    sun = light("SUN", 0.4, (2.0, -1.0, 3.0), color=(1.0, 1.0, 0.5), angle=math.radians(20), use_shadow=False)
    _switched(sun, use_multiple_importance_sampling=False)
    dull = light("AREA", 60.0, (0.5, 1.0, 3.0), color=(1.0, 0.5, 1.0), shape="DISK", size=1.0)
    dull.visible_diffuse = False
    opaque = light("AREA", 60.0, (-0.5, -3.0, 2.0), color=(0.5, 1.0, 1.0), shape="DISK", size=0.8)
    opaque.visible_transmission = False
    _switched(opaque, max_bounces=1)


@scene("lamp-shapes", samples=128)
def shapes() -> None:
    """Lamps before the camera: spheres and discs that face it, ellipses, a narrow and a parallel beam, unnormalised."""
    dim_stage(glossy=True)
    for lamp in (
        light("POINT", 20.0, (-1.6, 0.4, 2.0), shadow_soft_size=0.25, use_soft_falloff=False),
        light("POINT", 20.0, (-0.9, 0.4, 2.0), shadow_soft_size=0.25, use_soft_falloff=True),
        light("SPOT", 40.0, (-0.2, 0.4, 2.0), (0, -3, 1), shadow_soft_size=0.25, use_soft_falloff=False, spot_size=1.2),
        light("AREA", 20.0, (0.5, 0.4, 2.0), (0.3, -3, 1), shape="ELLIPSE", size=0.5, size_y=0.3),
        light("AREA", 5.0, (1.2, 0.4, 2.0), (0, -6, 2.6), shape="DISK", size=0.5, spread=math.radians(30)),
        light("AREA", 2.0, (1.8, 0.4, 2.0), (0, -6, 2.2), shape="RECTANGLE", size=0.3, size_y=0.5, normalize=False),
        light("SPOT", 0.5, (-1.0, -2.0, 2.2), (-1, 0, 0), shadow_soft_size=0.2, normalize=False),
        light("AREA", 3.0, (1.5, -1.5, 2.5), (1.5, -1.4, 0), size=0.8, spread=0.0),
    ):  # fmt: skip
        lamp.visible_camera = True
    sun = light("SUN", 0.05, (1.0, -3.0, 3.0), angle=math.radians(15), normalize=False)
    sun.data.use_temperature, sun.data.temperature = True, 4000.0


@scene("lamp-sheared", samples=128)
def sheared() -> None:
    """Area lamps whose parents are scaled differently along their axes, above a floor."""
    dim_stage()
    show(diffuse((0.7, 0.7, 0.7)))
    holder = add_object("holder", None)
    turned = Matrix.Rotation(0.7, 4, "X") @ Matrix.Rotation(0.6, 4, "Y") @ Matrix.Rotation(0.7, 4, "Z")
    for number, (shape, spread) in enumerate((("RECTANGLE", 180), ("ELLIPSE", 180), ("RECTANGLE", 70))):
        lamp = light("AREA", 40.0, (0, 0, 0), shape=shape, size=0.9, size_y=0.6, spread=math.radians(spread))
        lamp.visible_camera = True
        lamp.location, lamp.rotation_euler = (0, 0, 0), (0, 0, 0)
        place = Matrix.Translation((1.4 * (number - 1), 0.3, 2.0))
        lamp.parent = holder
        lamp.matrix_parent_inverse = place @ Matrix.Diagonal((1.3, 0.7, 1.0, 1.0)) @ turned
    bpy.context.view_layer.update()
