# SPDX-License-Identifier: GPL-3.0-or-later
"""A white displaced sphere in a white world is white: displacement neither loses light nor makes any."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from engine.array_types import Float32Array
from engine.render.report import RenderResult
from engine.render.session import Session
from engine.scene.description import Link, Material, Mesh, Node, NodeGraph, SceneDescription, World
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


def bumpy_sphere() -> SceneDescription:
    """Before a white sky that no light sample looks for."""
    world = World("white", "White", None, color=(1.0, 1.0, 1.0), sampling="NONE")
    return replace(
        floor_scene(size=(24, 24)), camera=looking_down(4.0), meshes=[octahedron()], materials=[white()],
        instances=plain_instances(np.eye(4)), world=world, lights=[],
    )  # fmt: skip


def seen_of(result: RenderResult) -> Float32Array:
    """Pixels that show the sphere, float32 (N, 3)."""
    seen = result.passes["Depth"][..., 0] < 100.0
    assert 60 < seen.sum() < 500
    return result.passes["Combined"][seen][:, :3]


def render(**settings: Any) -> RenderResult:
    """Paths of any length."""
    chosen = {"threads": 1, "max_bounces": 512, "diffuse_bounces": 512, "use_russian_roulette": False, **settings}
    session = Session(RenderSettings(**chosen))
    session.load(bumpy_sphere())
    result = session.render(passes={"Combined", "Depth"})
    session.close()
    return result


def test_a_white_displaced_sphere_is_white() -> None:
    # Each path ends in the world with a throughput of 1, whatever it has met.
    assert np.allclose(seen_of(render(samples=32, seed=3)), 1.0, atol=2e-3)


def test_it_stays_white_while_paths_are_guided() -> None:
    """Within four standard errors of six renders, which are less than a hundredth."""
    forced = {"guiding_method": "VMM", "guiding_trial": False, "learn_guiding_probability": False}
    results = [render(samples=63, seed=seed, **forced) for seed in range(6)]
    assert all(result.report.guiding.candidates_per_vertex == 1.0 for result in results)
    means = np.array([seen_of(result).mean(dtype=np.float64) for result in results])
    error = means.std(ddof=1) / np.sqrt(len(means))
    assert abs(means.mean() - 1.0) < 4.0 * error + 1e-4 and error < 0.0025
