# SPDX-License-Identifier: GPL-3.0-or-later
"""Facets of glass that disperses: GGX stands for Beckmann's, and is named."""

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
