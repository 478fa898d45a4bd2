# SPDX-License-Identifier: GPL-3.0-or-later
"""Hair's nodes: tangents on triangles, and which strands light passes beside."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from engine.kernels.bsdf import chiang, huang
from engine.kernels.bsdf.hair import HAIR_TANGENT
from engine.kernels.bsdf.kinds import CHIANG, HAIR_REFLECTION, HUANG
from engine.scene.description import NodeGraph
from engine.state.lanes import POINT_FLAG_BACKFACING, POINT_FLAGS
from engine.state.shaders import PROGRAM_FLAGS, PROGRAM_HAS_LOBES, PROGRAM_MAY_BE_TRANSPARENT
from tests.helpers.shader_harness import Graph, compile_one, run, square_points

_DIAGONAL = math.sqrt(0.5)


def _principled(model: str, parametrization: str = "COLOR", **inputs: Any) -> NodeGraph:
    graph = Graph()
    settings = {"model": model, "parametrization": parametrization}
    return graph.surface(graph.link("ShaderNodeBsdfHairPrincipled", "BSDF", inputs=inputs, **settings))


@pytest.mark.parametrize("model", ["CHIANG", "HUANG"])
def test_principled_hair_on_triangles_lies_along_their_first_edge(model: str) -> None:
    shaders, _, notices = compile_one(_principled(model))
    assert not notices
    points = square_points([(0.75, 0.25), (0.25, 0.75), (0.75, 0.25)])
    points.integer[2, POINT_FLAGS] = POINT_FLAG_BACKFACING
    closures = run(shaders, points)
    assert (closures.kind[:3, 0] == (HUANG if model == "HUANG" else CHIANG)).all()
    tangents = closures.param[:3, 0, HAIR_TANGENT : HAIR_TANGENT + 3]
    assert np.allclose(tangents, [(1.0, 0.0, 0.0), (_DIAGONAL, _DIAGONAL, 0.0), (-1.0, 0.0, 0.0)])


def test_hair_on_triangles_lies_along_their_last_edge() -> None:
    graph = Graph()
    surface = graph.surface(graph.link("ShaderNodeBsdfHair", "BSDF", component="Reflection"))
    closures = run(compile_one(surface)[0], square_points([(0.75, 0.25), (0.25, 0.75)]))
    assert (closures.kind[:2, 0] == HAIR_REFLECTION).all()
    tangents = closures.param[:2, 0, HAIR_TANGENT : HAIR_TANGENT + 3]
    assert np.allclose(tangents, [(_DIAGONAL, _DIAGONAL, 0.0), (0.0, 1.0, 0.0)])


@pytest.mark.parametrize(("model", "aspect"), [("CHIANG", 0.5), ("HUANG", 1.0), ("HUANG", 0.5)])
def test_light_passes_beside_ellipses_alone(model: str, aspect: float) -> None:
    shaders, _, _ = compile_one(_principled(model, **{"Aspect Ratio": aspect}))
    flags = shaders.programs[0, PROGRAM_FLAGS]
    assert flags & PROGRAM_HAS_LOBES
    assert bool(flags & PROGRAM_MAY_BE_TRANSPARENT) == (model == "HUANG" and aspect != 1.0)


@pytest.mark.parametrize("parametrization", ["ABSORPTION", "MELANIN", "COLOR"])
def test_huang_has_all_colors(parametrization: str) -> None:
    """As Chiang's model of the same roughness along and around the fibre: what passes along a radius."""
    inputs = {
        "Color": (0.6, 0.3, 0.2, 1.0), "Absorption Coefficient": (0.1, 0.4, 1.2), "Melanin": 0.6,
        "Melanin Redness": 0.4, "Tint": (0.9, 0.7, 0.5, 1.0), "Roughness": 0.4, "Radial Roughness": 0.4,
    }  # fmt: skip
    passed = []
    for model, column in (("CHIANG", chiang.LOBE.colors[0]), ("HUANG", huang.LOBE.colors[0])):
        shaders, _, _ = compile_one(_principled(model, parametrization, **inputs))
        passed.append(run(shaders, square_points((0.75, 0.25))).param[0, 0, column : column + 3])
    assert np.allclose(*passed)
    assert ((passed[0] > 0.0) & (passed[0] < 1.0)).all()
    assert passed[0][0] > passed[0][1] > passed[0][2]
