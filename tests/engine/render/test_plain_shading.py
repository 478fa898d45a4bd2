# SPDX-License-Identifier: GPL-3.0-or-later
"""What is folded once a program, and drawn side by side, shows in no picture."""

from __future__ import annotations

import numpy as np
import pytest

from engine.render.session import Session
from engine.scene.description import Link, Material, Node, NodeGraph, SceneDescription
from engine.settings import RenderSettings
from tests.helpers.small_scenes import emitter_scene, material


def _scene(is_folded: bool, roughness: float) -> SceneDescription:
    """A floor of Principled under an emissive square; an alpha of one that no compiler can know keeps it whole."""
    color = Node("ShaderNodeNewGeometry", "Geometry")
    inputs = {
        "Base Color": Link(0, "Position"), "Roughness": roughness, "IOR": 1.6, "Specular Tint": (1.0, 0.6, 0.3, 1.0),
    }
    nodes = [color, Node("ShaderNodeAttribute", "Attribute", {}, {"attribute_name": "nothing"})]
    if not is_folded:
        inputs["Alpha"] = Link(1, "Alpha")
    nodes.append(Node("ShaderNodeBsdfPrincipled", "Principled", inputs))
    description = emitter_scene()
    description.instances.motion = {}
    description.meshes[1].motion_vertices = None
    glow = material("Glow", (40.0, 30.0, 20.0), "ShaderNodeEmission")
    description.materials = [Material("Floor", "Floor", NodeGraph(nodes, Link(2, "BSDF"))), glow]
    return description


@pytest.mark.parametrize("roughness", [0.1, 0.6])
def test_a_folded_material_looks_as_it_does_whole(roughness: float) -> None:
    pictures = []
    for is_folded in (True, False):
        session = Session(RenderSettings(samples=16, threads=1, max_bounces=4))
        session.load(_scene(is_folded, roughness))
        pictures.append(session.render().passes["Combined"][..., :3])
    folded, whole = pictures
    assert whole.mean() > 0.02
    # Rounding may send a path another way.
    differs = np.abs(folded - whole) > 1e-5 + 1e-3 * np.abs(whole)
    assert differs.any(axis=-1).mean() < 0.02
    assert folded.mean() == pytest.approx(whole.mean(), rel=1e-3)
