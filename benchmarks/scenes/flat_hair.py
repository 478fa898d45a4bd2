# SPDX-License-Identifier: GPL-3.0-or-later
"""Strands of elliptical cross section: hair by Huang's model on the lit stage."""

from __future__ import annotations

from typing import Any

import bpy
import numpy as np

from benchmarks.scenes.registry import scene
from benchmarks.scenes.studio import Nodes, Socket, add_object, lit_stage, material, sphere

_ELLIPSES = "Cycles' light samples of flat strands differ from its own sampling of them"


@scene("hair-huang", samples=128, note=_ELLIPSES, allowance=0.03)
def fur() -> None:
    """A ball of particle hair, which has no normals: its ellipses are turned as Cycles turns them there."""

    def surface(nodes: Nodes) -> Socket:
        settings = {"model": "HUANG", "parametrization": "COLOR"}
        return nodes("BsdfHairPrincipled", settings, Color=(0.5, 0.25, 0.1), Roughness=0.3, Random_Roughness=0.3)

    lit_stage()
    bpy.context.scene.cycles_curves.shape = "RIBBONS"
    ball = add_object("ball", sphere("ball", material("red", surface), 0.7), (0.0, 0.0, 1.0))
    hair = ball.modifiers.new("fur", "PARTICLE_SYSTEM").particle_system.settings
    hair.type, hair.count, hair.hair_length, hair.render_step = "HAIR", 300, 0.5, 3
    hair.child_type, hair.rendered_child_count = "INTERPOLATED", 6
    hair.radius_scale, hair.root_radius, hair.tip_radius = 0.03, 1.0, 0.2


def _strands(surface: Any, radius: float) -> None:
    """Thick strands of a Curves object on the lit stage."""
    lit_stage()
    bpy.context.scene.cycles_curves.shape = "THICK"
    rng = np.random.default_rng(4)
    count = 60
    data = bpy.data.hair_curves.new("strands")
    data.add_curves([5] * count)
    roots = rng.uniform(-1.0, 1.0, (count, 1, 3)) * (1.2, 0.6, 0.0)
    steps = np.arange(5)[None, :, None] * (rng.normal(0.0, 0.1, (count, 1, 3)) + (0.0, 0.0, 0.3))
    data.position_data.foreach_set("vector", (roots + steps).astype(np.float32).ravel())
    radii = np.tile(np.linspace(radius, radius / 3.0, 5), count).astype(np.float32)
    data.attributes.new("radius", "FLOAT", "POINT").data.foreach_set("value", radii)
    data.materials.append(surface)
    add_object("strands", data)


@scene("hair-huang-round", samples=128)
def round_strands() -> None:
    """Round strands, thin enough for the camera to see all of one at once."""

    def surface(nodes: Nodes) -> Socket:
        settings = {"model": "HUANG", "parametrization": "ABSORPTION"}
        inputs = {"Aspect Ratio": 1.0, "Absorption Coefficient": (0.1, 0.3, 0.6)}
        return nodes("BsdfHairPrincipled", settings, inputs, Roughness=0.25)

    _strands(material("round", surface), 0.02)


@scene("hair-huang-flat", samples=128, note=_ELLIPSES, allowance=0.08)
def flat_strands() -> None:
    """Strands that are seen near, flat as their normals have it, with lobes of unequal weight."""

    def surface(nodes: Nodes) -> Socket:
        settings = {"model": "HUANG", "parametrization": "MELANIN"}
        inputs = {"R lobe": 0.8, "TT lobe": 1.2, "TRT lobe": 0.7, "Aspect Ratio": 0.5}
        return nodes("BsdfHairPrincipled", settings, inputs, Melanin=0.25, Roughness=0.25, Random_Color=0.5)

    _strands(material("flat", surface), 0.08)
