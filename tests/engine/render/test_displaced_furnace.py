# SPDX-License-Identifier: GPL-3.0-or-later
"""A white displaced sphere in a white world is white: displacement neither loses light nor makes any."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from engine.render.session import Session
from engine.scene.description import Link, Material, Mesh, Node, NodeGraph, World
from engine.scene.dicing import Dicing
from engine.scene.instances import plain_instances
from engine.settings import RenderSettings
from tests.helpers.small_scenes import floor_scene, looking_down

pytestmark = pytest.mark.estimator


def octahedron() -> Mesh:
    vertices = np.array([(1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0), (0, 0, 1), (0, 0, -1)], np.float32)
    triangles = [(a, b, c) if (a == 0) ^ (b == 2) ^ (c == 4) else (b, a, c)
                 for a in (0, 1) for b in (2, 3) for c in (4, 5)]  # fmt: skip
    dicing = Dicing(8, np.eye(3, 4), 0.15, 0.0, np.zeros((0, 4)), 0.0)
    faces = np.array(triangles, np.uint32)
    outward = np.einsum("ti,ti->t", np.cross(
        vertices[faces[:, 1]] - vertices[faces[:, 0]], vertices[faces[:, 2]] - vertices[faces[:, 0]]
    ), vertices[faces].mean(axis=1))  # fmt: skip
    assert (outward > 0.0).all()
    return Mesh("ball", "ball", vertices, faces, None, np.zeros(8, np.int32), dicing=dicing)


def white() -> Material:
    """White, and moved away from the centre onto a bumpy sphere."""
    nodes = [
        Node("ShaderNodeBsdfDiffuse", "White", {"Color": (1.0, 1.0, 1.0, 1.0), "Roughness": 0.0}),
        Node("ShaderNodeTexCoord", "Place"),
        Node("ShaderNodeTexNoise", "Noise", {"Vector": Link(1, "Object"), "Scale": 3.0, "Detail": 1.0}),
        Node("ShaderNodeVectorDisplacement", "Move",
             {"Vector": Link(4, "Vector"), "Midlevel": 0.0, "Scale": 1.0}, {"space": "OBJECT"}),
        Node("ShaderNodeVectorMath", "Out", {"Vector": Link(1, "Object"), "Scale": Link(2, "Fac")},
             {"operation": "SCALE"}),
    ]  # fmt: skip
    graph = NodeGraph(nodes, surface=Link(0, "BSDF"), displacement=Link(3, "Displacement"))
    return Material("white", "white", graph, displacement_method="DISPLACEMENT")


def test_a_white_displaced_sphere_is_white() -> None:
    world = World("white", "White", None, color=(1.0, 1.0, 1.0), sampling="NONE")
    description = replace(
        floor_scene(size=(24, 24)), camera=looking_down(4.0), meshes=[octahedron()], materials=[white()],
        instances=plain_instances(np.eye(4)), world=world, lights=[],
    )  # fmt: skip
    settings = RenderSettings(
        samples=32, threads=1, guiding_method="OFF", max_bounces=512, diffuse_bounces=512, seed=3,
        use_russian_roulette=False,
    )
    session = Session(settings)
    session.load(description)
    passes = session.render(passes={"Combined", "Depth"}).passes
    image, depth = passes["Combined"][..., :3], passes["Depth"][..., 0]
    seen = depth < 100.0
    assert 60 < seen.sum() < 500
    # Each path ends in the world with a throughput of 1, whatever it has met.
    assert np.allclose(image[seen], 1.0, atol=2e-3)
