# SPDX-License-Identifier: GPL-3.0-or-later
"""Facets of glass that disperses: those by Beckmann know one refractive index only, so GGX stands for them."""

from __future__ import annotations

from dataclasses import replace

from engine.scene.description import Node, NodeGraph

#: Nodes that refract, and their distribution where a description has none.
_DEFAULTS = {"ShaderNodeBsdfGlass": "MULTI_GGX", "ShaderNodeBsdfRefraction": "BECKMANN"}


def with_dispersing_facets(graph: NodeGraph) -> tuple[NodeGraph, list[str]]:
    """The graph with GGX of the same roughness instead of Beckmann's facets in glass, and names of the nodes."""

    def is_replaced(node: Node) -> bool:
        default = _DEFAULTS.get(node.kind)
        # Smooth glass has no facets.
        if default is None or node.inputs.get("Roughness", 0.0) == 0.0:
            return False
        return node.properties.get("distribution", default) == "BECKMANN"

    nodes = [
        replace(node, properties={**node.properties, "distribution": "GGX"}) if is_replaced(node) else node
        for node in graph.nodes
    ]
    return replace(graph, nodes=nodes), [node.name for node in graph.nodes if is_replaced(node)]
