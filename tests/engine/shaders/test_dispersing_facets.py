# SPDX-License-Identifier: GPL-3.0-or-later
"""Facets of glass that disperses: GGX stands for Beckmann's, and what does not disperse is named."""

from __future__ import annotations

import pytest

from engine.scene.description import Link, Node, NodeGraph
from engine.shaders.compiled_program import ProgramSource
from engine.shaders.compiler import compile_programs
from engine.shaders.dispersing_facets import with_dispersing_facets


def glass(kind: str, roughness: float, distribution: str | None) -> NodeGraph:
    properties = {} if distribution is None else {"distribution": distribution}
    inputs = {"Color": (1.0, 1.0, 1.0, 1.0), "Roughness": roughness, "IOR": 1.5}
    return NodeGraph([Node(f"ShaderNodeBsdf{kind}", "It", inputs, properties)], Link(0, "BSDF"))


@pytest.mark.parametrize(
    ("kind", "roughness", "distribution", "is_replaced"),
    [
        ("Refraction", 0.4, None, True), ("Refraction", 0.4, "BECKMANN", True), ("Refraction", 0.4, "GGX", False),
        ("Refraction", 0.0, "BECKMANN", False), ("Glass", 0.4, "BECKMANN", True), ("Glass", 0.4, None, False),
        ("Glass", 0.4, "MULTI_GGX", False), ("Glossy", 0.4, "BECKMANN", False),
    ],
)  # fmt: skip
@pytest.mark.parametrize("dispersion", [0.0, 0.01])
def test_what_stands_for_beckmann_is_named(
    kind: str, roughness: float, distribution: str | None, is_replaced: bool, dispersion: float
) -> None:
    graph = glass(kind, roughness, distribution)
    changed, names = with_dispersing_facets(graph)
    assert names == ["It"] * is_replaced
    assert (changed.nodes[0].properties.get("distribution") == "GGX") == (is_replaced or distribution == "GGX")
    assert graph.nodes[0].properties.get("distribution") == distribution
    _, _, notices = compile_programs([ProgramSource("M", graph, dispersion=dispersion)], [])
    named = is_replaced and dispersion != 0.0
    assert [notice.subject for notice in notices] == ["M / It"] * named


@pytest.mark.parametrize(
    ("kind", "inputs", "properties", "is_named"),
    [
        ("Glass", {"Thin Film Thickness": 300.0}, {}, True), ("Glass", {}, {}, False),
        ("Glass", {"Anisotropy": 0.5, "Roughness": 0.3}, {}, True), ("Glass", {"Anisotropy": 0.5}, {}, False),
        ("Principled", {"Transmission Weight": 1.0, "Thin Film Thickness": Link(1, "Ray Length")}, {}, True),
        ("Principled", {"Transmission Weight": 1.0, "Anisotropic": 0.5}, {}, True),
        ("Principled", {"Transmission Weight": 1.0, "Anisotropic": 0.5}, {"tints_by_bounce": False}, False),
        ("Principled", {"Transmission Weight": 1.0}, {}, False),
        ("Principled", {"Thin Film Thickness": 300.0}, {}, False),
    ],
)  # fmt: skip
def test_glass_that_does_not_disperse_is_named(kind: str, inputs: dict, properties: dict, is_named: bool) -> None:
    nodes = [Node(f"ShaderNodeBsdf{kind}", "It", inputs, properties), Node("ShaderNodeLightPath", "Path")]
    graph = NodeGraph(nodes, Link(0, "BSDF"))
    for dispersion in (0.0, 0.01):
        _, _, notices = compile_programs([ProgramSource("M", graph, dispersion=dispersion)], [])
        named = is_named and dispersion != 0.0
        assert [(notice.subject, notice.fallback) for notice in notices] == (
            [("M / It", "it bends all wavelengths alike")] * named
        )
