# SPDX-License-Identifier: GPL-3.0-or-later
"""Facets of glass that disperses: those by Beckmann know one refractive index only, so GGX stands for them."""

from __future__ import annotations

from dataclasses import replace

from engine.scene.description import NodeGraph

#: Nodes that refract, and their distribution where a description has none.
_DEFAULTS = {"ShaderNodeBsdfGlass": "MULTI_GGX", "ShaderNodeBsdfRefraction": "BECKMANN"}


def with_dispersing_facets(graph: NodeGraph) -> NodeGraph:
    """The graph with GGX of the same roughness instead of Beckmann's facets in glass."""
    nodes = [
        replace(node, properties={**node.properties, "distribution": "GGX"})
        if node.kind in _DEFAULTS and node.properties.get("distribution", _DEFAULTS[node.kind]) == "BECKMANN"
        else node
        for node in graph.nodes
    ]
    return replace(graph, nodes=nodes)
