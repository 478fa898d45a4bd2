# SPDX-License-Identifier: GPL-3.0-or-later
"""Boxes that light goes into, under a uniform sky: what they send back can be worked out on paper."""

from __future__ import annotations

from engine.scene.description import Link, Material, Node, NodeGraph
from tests.helpers.media_scenes import media_scene, placed


def below(method="RANDOM_WALK", color=(1.0, 1.0, 1.0), radius=(1.0, 1.0, 1.0), scale=0.5, **inputs):
    """A material of one Subsurface Scattering node."""
    values = {"Color": (*color, 1.0), "Radius": radius, "Scale": scale, **inputs}
    node = Node("ShaderNodeSubsurfaceScattering", "Below", values, {"falloff": method})
    return Material("Below", "Below", NodeGraph([node], Link(0, "BSSRDF")))


def box_scene(*materials, **settings):
    """Boxes of these materials, of edges of 2 m, whose tops fill the picture of a camera above the first."""
    transforms = [placed(offset=(3.0 * k, 0.0, 0.0)) for k in range(len(materials))]
    return media_scene(list(materials), transforms, **settings)
