# SPDX-License-Identifier: GPL-3.0-or-later
"""Coarse meshes that are shaded smooth, and what objects say of where their light ends."""

from __future__ import annotations

import bpy

from benchmarks.scenes.registry import scene
from benchmarks.scenes.studio import add_object, light, material, sphere, stage, world


@scene("terminator-shading", samples=64)
def terminator_shading() -> None:
    """Shading offsets of 0.3 and 1 on coarse balls, diffuse, glossy, mirrors and wax, by a sun and a lamp."""
    stage()
    world((0.1, 0.11, 0.12))
    light("SUN", 3.0, (-3.0, -0.5, 2.0), angle=0.4)
    light("POINT", 100.0, (2.5, -2.0, 3.0), shadow_soft_size=0.6)
    # What mirrors send to the floor is noise.
    bpy.context.scene.cycles.caustics_reflective = False
    surfaces = {
        "diffuse": lambda nodes: nodes("BsdfDiffuse", Color=(0.7, 0.6, 0.5)),
        "shiny": lambda nodes: nodes("BsdfAnisotropic", {"distribution": "GGX"}, Roughness=0.6),
        "mirror": lambda nodes: nodes("BsdfAnisotropic", {"distribution": "GGX"}, Roughness=0.0),
        "wax": lambda nodes: nodes("SubsurfaceScattering", Color=(0.7, 0.5, 0.4), Scale=0.1),
    }
    for column, (name, surface) in enumerate(surfaces.items()):
        for row, offset in enumerate((0.3, 1.0)):
            ball = sphere(name, material(name, surface), 0.4, 10, 6)
            placed = add_object(f"{name} {offset}", ball, (column - 1.5, 0.8 * row - 0.5, 0.4 + 0.5 * row))
            placed.shadow_terminator_shading_offset = offset
