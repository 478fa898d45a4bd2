# SPDX-License-Identifier: GPL-3.0-or-later
"""Facets of glass that disperses: those that are linked know one refractive index only. GGX stands for Beckmann's."""

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


def with_one_index(graph: NodeGraph) -> list[str]:
    """Names of nodes whose glass does not disperse: with a thin film, or anisotropic."""

    def has(node: Node, name: str) -> bool:
        return node.inputs.get(name, 0.0) != 0.0

    def is_linked(node: Node) -> bool:
        if node.kind == "ShaderNodeBsdfGlass":
            stretches = has(node, "Anisotropy") and has(node, "Roughness")
        elif node.kind == "ShaderNodeBsdfPrincipled" and has(node, "Transmission Weight"):
            tints = bool(node.properties.get("tints_by_bounce", True))
            stretches = tints and has(node, "Anisotropic") and node.inputs.get("Roughness", 0.5) != 0.0
        else:
            return False
        return stretches or has(node, "Thin Film Thickness")

    return [node.name for node in graph.nodes if is_linked(node)]
