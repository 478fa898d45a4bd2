# SPDX-License-Identifier: GPL-3.0-or-later
"""Motion of what is reflected is that of plain sampling, whatever guides the paths."""

from __future__ import annotations

import numpy as np
import pytest

from engine.render.data_passes import SPECULAR_MOTION
from engine.render.session import Session
from engine.scene.description import Link, Material, Node, NodeGraph, SceneDescription
from engine.scene.passes import PassMotion
from engine.settings import RenderSettings
from tests.helpers.small_scenes import corner_scene

SAMPLES = 128


def clear_diffuse() -> Material:
    """Of which a tenth is transparent: that lets diffuse reflections count."""
    nodes = [
        Node("ShaderNodeBsdfDiffuse", "Diffuse", {"Color": (0.8, 0.8, 0.8, 1.0), "Roughness": 0.0}),
        Node("ShaderNodeBsdfTransparent", "Clear", {"Color": (1.0, 1.0, 1.0, 1.0)}),
        Node("ShaderNodeMixShader", "Mix", {"Fac": 0.1, "Shader": Link(0, "BSDF"), "Shader_001": Link(1, "BSDF")}),
    ]
    return Material("Clear", "Clear", NodeGraph(nodes, Link(2, "Shader")))


def moving_wall() -> SceneDescription:
    """A floor under a black sky, and a wall beside it that slides to the side: all of the floor's indirect light."""
    description = corner_scene()
    description.materials = [clear_diffuse()]
    wall = description.instances.transform[1]
    before, after = wall.copy(), wall.copy()
    before[0, 3], after[0, 3] = -0.5, 0.5
    description.passes.motion = PassMotion(instances={1: np.stack([before, after])})
    return description


def reflected(method: str, **settings: object) -> float:
    """Mean of the pass's x [pixels]."""
    chosen = {"samples": SAMPLES, "threads": 1, "guiding_method": method, "guiding_trial": False, **settings}
    session = Session(RenderSettings(**chosen))
    session.load(moving_wall())
    result = session.render(passes=("Combined", SPECULAR_MOTION))
    session.close()
    return float(result.passes[SPECULAR_MOTION][..., 0].mean())


@pytest.mark.parametrize("settings", [{}, {"radiance_cache": "CONVERGING"}], ids=["guided", "with the cache"])
def test_guided_reflections_count_by_plain_samplings_share(settings: dict[str, str]) -> None:
    """Guided paths go to the wall more often than unguided ones, and those that do count less."""
    plain, guided = reflected("OFF"), reflected("VMM", **settings)
    assert abs(plain) > 0.1
    assert guided == pytest.approx(plain, rel=0.02)
