# SPDX-License-Identifier: GPL-3.0-or-later
"""Ray Portal BSDFs: what the compiler makes of them, and what is seen through one."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from engine.kernels.bsdf import kinds
from engine.kernels.bsdf.portal import PORTAL_DIRECTION, PORTAL_POSITION, RAY_PORTAL
from engine.kernels.bsdf.subsurface import SUBSURFACE_METHOD
from engine.scene.description import Link, Material, Node, NodeGraph
from engine.state.lanes import CLOSURE_WEIGHT
from engine.state.shaders import (
    PROGRAM_FLAGS,
    PROGRAM_HAS_PORTAL,
    PROGRAM_HAS_SUBSURFACE,
    PROGRAM_MAY_BE_TRANSPARENT,
)
from tests.helpers.media_renders import picture, render
from tests.helpers.media_scenes import media_scene, placed
from tests.helpers.shader_harness import Graph, compile_one, run
from tests.helpers.small_scenes import pit_scene

TINT = (0.9, 0.6, 0.3)
COLOR = (*TINT, 1.0)


@pytest.mark.parametrize("inputs, position, direction", [
    ({"Position": Link(0, "Vector"), "Direction": (0.0, 3.0, 4.0)}, (1.0, 2.0, 3.0), (0.0, 0.6, 0.8)),
    ({"Direction": (0.0, 0.0, 0.0)}, (0.5, 0.25, 0.0), (0.0, 0.0, -1.0)),
])  # fmt: skip
def test_a_portal_leads_where_its_node_says(inputs: dict[str, Any], position: Any, direction: Any) -> None:
    graph = Graph()
    graph.add("ShaderNodeCombineXYZ", inputs={"X": 1.0, "Y": 2.0, "Z": 3.0})
    portal = graph.link("ShaderNodeBsdfRayPortal", "BSDF", inputs={"Color": COLOR, **inputs})
    shaders, _names, notices = compile_one(graph.surface(portal))
    assert notices == []
    flags = shaders.programs[0, PROGRAM_FLAGS]
    # Shadow rays meet something opaque.
    assert flags & PROGRAM_HAS_PORTAL and not flags & (PROGRAM_MAY_BE_TRANSPARENT | PROGRAM_HAS_SUBSURFACE)
    closures = run(shaders)
    assert closures.count[0] == 1 and closures.kind[0, 0] == kinds.SUBSURFACE
    row = closures.param[0, 0]
    assert row[SUBSURFACE_METHOD] == RAY_PORTAL
    for column, expected in ((PORTAL_POSITION, position), (PORTAL_DIRECTION, direction), (CLOSURE_WEIGHT, TINT)):
        np.testing.assert_allclose(row[column : column + 3], expected, rtol=1e-6)


def _portal(share: float = 1.0, **inputs: Any) -> Material:
    """A material that is a portal, the rest black."""
    nodes = [
        Node("ShaderNodeBsdfRayPortal", "Portal", {"Color": COLOR, **inputs}),
        Node("ShaderNodeBsdfDiffuse", "Black", {"Color": (0.0, 0.0, 0.0, 1.0)}),
        Node("ShaderNodeMixShader", "Mix", {"Fac": share, "Shader": Link(1, "BSDF"), "Shader_001": Link(0, "BSDF")}),
        Node("ShaderNodeCombineXYZ", "There", {"X": 50.0, "Y": 0.0, "Z": 0.0}),
    ]
    return Material("Portal", "Portal", NodeGraph(nodes, Link(2, "Shader")))


def _glow() -> Material:
    emission = Node("ShaderNodeEmission", "Emission", {"Color": (0.2, 0.4, 0.8, 1.0), "Strength": 3.0})
    return Material("Glow", "Glow", NodeGraph([emission], Link(0, "Emission")))


def test_a_portal_shows_what_is_elsewhere() -> None:
    """A box that glows, 50 m away, all around where the portal leads; behind the portal itself is a white sky."""
    there = {"Position": Link(3, "Vector"), "Direction": (0.0, 0.0, 1.0)}
    places = [placed(), placed(offset=(50.0, 0.0, 0.0))]
    for share in (1.0, 0.5):
        image = picture(media_scene([_portal(share, **there), _glow()], places), samples=64)
        expected = share * np.array(TINT) * np.array((0.6, 1.2, 2.4))
        np.testing.assert_allclose(image[..., :3].mean(axis=(0, 1)), expected, rtol=1e-4 if share == 1.0 else 0.05)


def test_a_portal_that_says_nothing_lets_all_through() -> None:
    """Rays go on from where they are: twice through a box, tinted by each side."""
    image = picture(media_scene([_portal()], [placed()]), samples=4)
    np.testing.assert_allclose(image[..., :3].mean(axis=(0, 1)), np.square(TINT), rtol=1e-4)


@pytest.mark.parametrize(
    "settings",
    [{"guiding_method": "VMM", "learn_guiding_probability": False}, {"radiance_cache": "CONVERGING"}],
    ids=["guided", "with the cache"],
)
def test_what_is_learned_through_a_portal_changes_no_mean(settings: dict[str, Any]) -> None:
    """One of a pit's walls leads to its middle: what paths find behind it teaches what they met before."""
    scene = pit_scene((16, 16))
    portal = _portal(Position=Link(3, "Vector"))
    assert portal.graph is not None
    portal.graph.nodes[3].inputs.update(X=0.0, Z=1.0)
    scene.materials.append(portal)
    scene.instances.material_offset, scene.instances.materials = np.arange(5), np.array([0, 1, 0, 0, 0], np.int32)
    long = {"samples": 63, "max_bounces": 32, "diffuse_bounces": 32, "guiding_trial": False}
    means = []
    for given in ({}, settings):
        results = [render(scene, seed=seed, **long, **given) for seed in range(6)]
        for report in (result.report for result in results):
            assert (report.guiding.candidates_per_vertex == 1.0) == ("guiding_method" in given)
            assert (sum(report.cached_shares) > 0.2) == ("radiance_cache" in given)
        means.append(np.array([found.passes["Combined"][..., :3].mean(axis=(0, 1)) for found in results], np.float64))
    plain, learned = means
    error = np.hypot(plain.std(axis=0, ddof=1), learned.std(axis=0, ddof=1)) / np.sqrt(6)
    assert (np.abs(plain.mean(axis=0) - learned.mean(axis=0)) <= 4.0 * error).all()
    # The test can see a bias of 3%.
    assert (4.0 * error < 0.03 * plain.mean(axis=0)).all()
