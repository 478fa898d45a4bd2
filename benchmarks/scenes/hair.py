# SPDX-License-Identifier: GPL-3.0-or-later
"""Hair and points: a ball of fur, curves and a cloud of points on the lit stage."""

from __future__ import annotations

from typing import Any

import bpy
import numpy as np

from benchmarks.scenes.registry import scene
from benchmarks.scenes.studio import Nodes, Socket, Surface, add_object, diffuse, lit_stage, material, sphere


def _brown(nodes: Nodes) -> Socket:
    return nodes("BsdfDiffuse", Color=(0.7, 0.45, 0.25))


def _fur(name: str, surface: Surface, drawn_as: str, **settings: Any) -> None:
    """A ball of fur on the lit stage."""
    lit_stage()
    bpy.context.scene.cycles_curves.shape = drawn_as
    ball = add_object("ball", sphere("ball", material(name, surface), 0.7), (0.0, 0.0, 1.0))
    system = ball.modifiers.new("fur", "PARTICLE_SYSTEM").particle_system
    hair = system.settings
    hair.type, hair.count, hair.hair_length, hair.render_step = "HAIR", 300, 0.5, 3
    hair.child_type, hair.rendered_child_count = "INTERPOLATED", 6
    hair.radius_scale, hair.root_radius, hair.tip_radius = 0.03, 1.0, 0.2
    hair.clump_factor, hair.kink = 0.5, "WAVE"
    for key, value in settings.items():
        setattr(hair, key, value)


@scene("hair-ribbons")
def ribbons() -> None:
    """Particle hair as flat ribbons of Lambert's law."""
    _fur("brown", _brown, "RIBBONS")


@scene("hair-round")
def rounded() -> None:
    """Particle hair that is round, with closed tips."""
    _fur("brown", _brown, "THICK", use_close_tip=True, shape=0.4)


@scene("hair-transparent")
def transparent() -> None:
    """Hair that lets more light through towards its tips, by Curves Info."""

    def surface(nodes: Nodes) -> Socket:
        parts = {0: nodes("HairInfo", output="Intercept"), 1: _brown(nodes), 2: nodes("BsdfTransparent")}
        return nodes("MixShader", None, parts)

    _fur("clear", surface, "RIBBONS", use_close_tip=False)


@scene("hair-principled", samples=128)
def principled() -> None:
    """Chiang's model, of a light colour."""

    def surface(nodes: Nodes) -> Socket:
        settings = {"model": "CHIANG", "parametrization": "MELANIN"}
        return nodes("BsdfHairPrincipled", settings, Melanin=0.3, Roughness=0.3, Random_Color=0.3)

    _fur("blond", surface, "RIBBONS")


@scene("hair-curves")
def curves() -> None:
    """A Curves object of straight and round segments, transformed unevenly."""
    lit_stage()
    bpy.context.scene.cycles_curves.shape = "THICK_LINEAR"
    rng = np.random.default_rng(4)
    data = bpy.data.hair_curves.new("strands")
    data.add_curves([5] * 300)
    roots = rng.uniform(-1.0, 1.0, (300, 1, 3)) * (1.2, 0.6, 0.0)
    steps = np.arange(5)[None, :, None] * (rng.normal(0.0, 0.1, (300, 1, 3)) + (0.0, 0.0, 0.3))
    data.position_data.foreach_set("vector", (roots + steps).astype(np.float32).ravel())
    radii = np.tile(np.linspace(0.03, 0.01, 5), 300).astype(np.float32)
    data.attributes.new("radius", "FLOAT", "POINT").data.foreach_set("value", radii)
    data.materials.append(diffuse((0.3, 0.6, 0.3), "green"))
    add_object("strands", data).scale = (1.0, 1.3, 0.9)


@scene("points")
def points() -> None:
    """A cloud of points of several radii."""
    lit_stage()
    rng = np.random.default_rng(5)
    # Only an operator makes points.
    bpy.ops.object.pointcloud_random_add()
    data = bpy.context.object.data
    count = len(data.points)
    where = rng.uniform(-1.0, 1.0, (count, 3)) * (1.2, 0.8, 0.8) + (0.0, 0.0, 1.0)
    data.attributes["position"].data.foreach_set("vector", where.astype(np.float32).ravel())
    data.attributes["radius"].data.foreach_set("value", rng.uniform(0.02, 0.12, count).astype(np.float32))
    data.materials.append(diffuse((0.6, 0.3, 0.3), "red"))
