# SPDX-License-Identifier: GPL-3.0-or-later
"""Settings that no scene has by default: whoever does not read them from Cycles' makes another picture."""

from __future__ import annotations

from typing import Any

import bpy

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
    lit_stage,
    material,
    quad,
    resolution,
    show,
    sphere,
    stage,
    world,
)


def _set(**settings: Any) -> None:
    for name, value in settings.items():
        setattr(bpy.context.scene.cycles, name, value)


def _white_box() -> None:
    """A closed room of bright walls, a lamp and a ball in it."""
    walls = diffuse((0.9, 0.88, 0.86), "wall")
    for name, location, rotation in (
        ("Floor", (0, 0, 0), (0, 0, 0)), ("Ceiling", (0, 0, 3), (180, 0, 0)), ("Back", (0, 2, 1.5), (90, 0, 0)),
        ("Front", (0, -2, 1.5), (-90, 0, 0)), ("Left", (-2, 0, 1.5), (0, 90, 0)), ("Right", (2, 0, 1.5), (0, -90, 0)),
    ):  # fmt: skip
        add_object(name, quad(name, walls, 4.4, 4.4), location, rotation)
    add_object("Ball", sphere("Ball", diffuse((0.9, 0.5, 0.3), "clay"), 0.6), (0.4, 0.5, 0.6))
    light("AREA", 30.0, (-0.8, 0.2, 2.6), (0.0, 0.0, 0.0), size=0.6)
    camera((0.0, -1.9, 1.5), (0.0, 1.0, 1.2), 22.0)


@scene("limits-many", samples=96)
def many_bounces() -> None:
    """A closed white room of 64 bounces: half of its light comes after the fourth, 18% after the twelfth."""
    resolution()
    _white_box()
    _set(max_bounces=64, diffuse_bounces=64, glossy_bounces=64, transmission_bounces=64)


@scene("limits-few")
def few_bounces() -> None:
    """One diffuse bounce, no glossy one, two through glass, one transparent surface."""
    stage()
    world((0.5, 0.55, 0.6))
    # A mesh and no lamp: Cycles counts lamps on a path's way as transparent surfaces.
    add_object("Panel", quad("Panel", emitter((1, 1, 1), 6.0), 3.0, 3.0), (1.5, -1.5, 4.0), (180, 0, 0))
    show(material("glass", lambda nodes: nodes("BsdfGlass", Color=(1, 1, 1), Roughness=0.2, IOR=1.45)))
    add_object("Mirror", box("Mirror", material("mirror", _mirror), (0.2, 1.5, 1.2)), (1.4, 0.9, 0.6), (0, 0, 30))
    card = material("card", lambda nodes: nodes("BsdfTransparent", Color=(0.6, 0.8, 0.9)))
    for x in (-1.2, -1.0):
        add_object("Card", quad("Card", card, 0.8, 0.8), (x, -0.9, 0.5), (90, 0, 5))
    _set(max_bounces=3, diffuse_bounces=1, glossy_bounces=0, transmission_bounces=2, transparent_max_bounces=1)


def _mirror(nodes: Nodes) -> Socket:
    return nodes("BsdfAnisotropic", {"distribution": "GGX"}, Color=(0.9, 0.9, 0.9), Roughness=0.1)


@scene("limits-gloss", samples=96)
def filtered_gloss() -> None:
    """Strong Filter Glossy, no reflective caustics, roulette that leaves five bounces alone, a high light threshold."""
    stage()
    light("AREA", 250.0, (1.0, -1.5, 3.5), (0.0, 0.0, 0.5), size=1.2)
    show(material("metal", lambda nodes: nodes("BsdfAnisotropic", Color=(0.95, 0.8, 0.5), Roughness=0.05)))
    _set(
        blur_glossy=4.0, caustics_reflective=False, min_light_bounces=5, light_sampling_threshold=0.05, max_bounces=24,
        diffuse_bounces=24, glossy_bounces=24,
    )  # fmt: skip


@scene("limits-film")
def film() -> None:
    """Exposure, a wide Gaussian filter, a film without background."""
    lit_stage()
    show(diffuse((0.6, 0.3, 0.2), "paint"))
    _set(film_exposure=0.4, pixel_filter_type="GAUSSIAN", filter_width=3.5)
    bpy.context.scene.render.film_transparent = True
