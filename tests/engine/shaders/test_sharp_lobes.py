# SPDX-License-Identifier: GPL-3.0-or-later
"""Which materials photons begin at: those with a mirror's lobe, and those all of whose lobes may be sharp."""

from __future__ import annotations

from typing import Any

import pytest

from engine.shaders.compiled_program import ProgramSource
from engine.shaders.pools import ScenePools
from engine.shaders.surface_compiler import SurfaceCompiler
from tests.helpers.shader_harness import Graph

_GLASS, _GLOSSY, _DIFFUSE = "ShaderNodeBsdfGlass", "ShaderNodeBsdfAnisotropic", "ShaderNodeBsdfDiffuse"
_PRINCIPLED, _METALLIC = "ShaderNodeBsdfPrincipled", "ShaderNodeBsdfMetallic"
#: Node, inputs, whether photons begin there.
_CASES: list[tuple[str, dict[str, Any], bool]] = [
    (_GLASS, {"Roughness": 0.0}, True),
    (_GLASS, {"Roughness": 0.2}, True),
    (_GLASS, {"Roughness": 0.33}, False),
    (_GLOSSY, {"Roughness": 0.1}, True),
    (_GLOSSY, {"Roughness": 0.4}, False),
    ("ShaderNodeBsdfRefraction", {"Roughness": 0.1, "IOR": 1.3}, True),
    (_METALLIC, {"Roughness": 0.1}, True),
    (_PRINCIPLED, {"Roughness": 0.1, "Metallic": 1.0}, True),
    (_PRINCIPLED, {"Roughness": 0.35, "Metallic": 1.0}, False),
    (_PRINCIPLED, {"Roughness": 0.1, "Metallic": 0.9}, False),
    (_PRINCIPLED, {"Roughness": 0.1}, False),
    (_PRINCIPLED, {"Roughness": 0.1, "Transmission Weight": 1.0}, True),
    (_PRINCIPLED, {"Roughness": 0.1, "Transmission Weight": 1.0, "Sheen Weight": 0.5}, False),
    (_PRINCIPLED, {"Roughness": 0.1, "Metallic": 1.0, "Coat Weight": 1.0, "Coat Roughness": 0.5}, False),
    # The coat is a mirror.
    (_PRINCIPLED, {"Roughness": 0.5, "Coat Weight": 1.0, "Coat Roughness": 0.0}, True),
    (_DIFFUSE, {}, False),
]


def _makes_caustics(graph: Graph, surface: Any) -> bool:
    return SurfaceCompiler(ScenePools([], None), ProgramSource("M", graph.surface(surface))).compile().makes_caustics


@pytest.mark.parametrize(("node", "inputs", "expected"), _CASES, ids=lambda value: str(value))
def test_photons_begin_where_light_stays_together(node: str, inputs: dict[str, Any], expected: bool) -> None:
    graph = Graph()
    color = graph.link("ShaderNodeNewGeometry", "Position")
    name = "Base Color" if node in (_PRINCIPLED, _METALLIC) else "Color"
    assert _makes_caustics(graph, graph.link(node, "BSDF", inputs={name: color, **inputs})) == expected


def test_a_roughness_that_varies_may_be_sharp_somewhere() -> None:
    graph = Graph()
    varying = graph.link("ShaderNodeNewGeometry", "Backfacing")
    assert _makes_caustics(graph, graph.link(_GLOSSY, "BSDF", inputs={"Roughness": varying}))


def test_sharp_lobes_over_rough_ones_are_no_casters() -> None:
    """Photons are gathered there."""
    graph = Graph()
    shaders = [graph.link(_GLOSSY, "BSDF", inputs={"Roughness": 0.1}), graph.link(_DIFFUSE, "BSDF")]
    inputs = {"Fac": 0.5, "Shader": shaders[0], "Shader_001": shaders[1]}
    mixed = graph.link("ShaderNodeMixShader", "Shader", inputs=inputs)
    assert not _makes_caustics(graph, mixed)
