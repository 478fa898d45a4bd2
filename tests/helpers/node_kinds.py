# SPDX-License-Identifier: GPL-3.0-or-later
"""Kinds of shader nodes: all that this Blender has, and those that the engine knows. Needs bpy."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import bpy

from engine.shaders import nodes_closure
from engine.shaders.node_values import gives_values

#: Resolved by the export, or no nodes that anything could be linked from.
STRUCTURE = {
    "NodeFrame", "NodeGroupInput", "NodeGroupOutput", "NodeReroute", "ShaderNodeGroup", "ShaderNodeCustomGroup",
    "ShaderNodeOutputAOV", "ShaderNodeOutputLight", "ShaderNodeOutputLineStyle", "ShaderNodeOutputMaterial",
    "ShaderNodeOutputWorld",
}  # fmt: skip
#: Reported whole, whatever their inputs and settings.
REPORTED_WHOLE = {
    "ShaderNodeAmbientOcclusion", "ShaderNodeBevel", "ShaderNodeTexIES", "ShaderNodeTexSky", "ShaderNodeWireframe",
}  # fmt: skip


def known(kind: str) -> bool:
    """Whether the engine knows nodes of this kind."""
    if kind in REPORTED_WHOLE:
        return False
    closure = nodes_closure.CLOSURES.get(kind)
    named = gives_values(kind) or kind in nodes_closure.MIXES or (closure is not None and closure.inputs is not None)
    return named or kind in ("ShaderNodeBump", "ShaderNodeDisplacement")


def kinds(tree: Any) -> list[str]:
    """All kinds of nodes that fit into the tree."""

    def below(base: Any) -> Iterator[Any]:
        for cls in base.__subclasses__():
            yield cls
            yield from below(cls)

    names = {cls.bl_rna.identifier for cls in below(bpy.types.Node)}
    names |= {name for name in dir(bpy.types) if "Node" in name}
    found = []
    for name in sorted(names - STRUCTURE):
        try:
            tree.nodes.remove(tree.nodes.new(name))
        except RuntimeError:
            continue
        found.append(name)
    return found


def settings_of(node: Any) -> dict[str, Any]:
    """All switches and enums of a node, whatever they are for, by name."""
    common = set(bpy.types.ShaderNode.bl_rna.properties.keys())
    return {
        prop.identifier: prop
        for prop in node.bl_rna.properties
        if prop.identifier not in common and prop.type in ("ENUM", "BOOLEAN", "INT", "FLOAT", "STRING")
    }
