# SPDX-License-Identifier: GPL-3.0-or-later
"""Fast GI Approximation: later bounces look at what is near, or surfaces receive light where the sky is free."""

from __future__ import annotations

import bpy

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


def _room(method: str) -> None:
    """A corner of a room under a bright sky, with a lamp: things that reflect, refract and let through stand in it."""
    resolution()
    camera((0.6, -5.4, 2.2), (0.0, 0.0, 0.8), 40.0)
    world((0.5, 0.6, 0.8))
    light("POINT", 120.0, (1.2, -1.6, 2.6), shadow_soft_size=0.05)
    add_object("Floor", quad("Floor", diffuse((0.7, 0.65, 0.6), "floor"), 6.0, 6.0))
    add_object("Back", box("Back", diffuse((0.75, 0.75, 0.7), "back"), (6.0, 0.2, 3.0)), (0.0, 1.6, 1.5))
    add_object("Side", box("Side", diffuse((0.7, 0.2, 0.1), "side"), (0.2, 4.0, 3.0)), (-2.0, 0.0, 1.5))
    near = add_object("Near", box("Near", diffuse((0.2, 0.6, 0.3), "near"), (0.8, 0.8, 1.0)), (-1.1, 0.5, 0.5))
    near.cycles.ao_distance = 0.3
    shiny = material("shiny", lambda nodes: nodes("BsdfGlossy", Color=(0.9, 0.8, 0.6), Roughness=0.3))
    add_object("Shiny", sphere("Shiny", shiny, 0.45, 24, 12), (0.1, 0.2, 0.45))
    glass = material("glass", lambda nodes: nodes("BsdfGlass", Color=(0.9, 0.95, 1.0), Roughness=0.2, IOR=1.3))
    add_object("Glass", sphere("Glass", glass, 0.4, 24, 12), (1.1, -0.1, 0.4))
    half = material(
        "half",
        lambda nodes: nodes(
            "MixShader", inputs={0: 0.5, 1: nodes("BsdfTransparent", Color=(0.9, 0.9, 0.6)),
                                 2: nodes("BsdfDiffuse", Color=(0.8, 0.8, 0.9))},
        ),
    )  # fmt: skip
    add_object("Pane", quad("Pane", half, 1.0, 1.2), (1.4, 0.9, 0.7), (80, 0, -20))
    settings = bpy.context.scene.cycles
    settings.use_fast_gi, settings.fast_gi_method = True, method
    settings.ao_bounces_render = 2
    lighting = bpy.context.scene.world.light_settings
    lighting.ao_factor, lighting.distance = 0.6, 1.2


@scene("fast-gi-replace")
def replaced() -> None:
    """A room whose light of later bounces is a share of the sky, where nothing near hides it; a box has a distance of
    its own.
    """
    _room("REPLACE")


@scene("fast-gi-add")
def added() -> None:
    """The same room, whose surfaces receive white light on top, where nothing near hides the sky."""
    _room("ADD")
