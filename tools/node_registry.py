# SPDX-License-Identifier: GPL-3.0-or-later
"""Blender's own shader nodes, and what the engine says of each: for docs/nodes.md and the tests of coverage.

`bpy` is needed. A tree is any that shader nodes fit into.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import bpy

from engine.scene.description import Link, Node, NodeGraph, Notice
from engine.shaders.compiled_program import ProgramSource
from engine.shaders.compiler import compile_programs

#: Resolved by the export, or no nodes that anything could be linked from.
STRUCTURE = {
    "GeometryNodeMenuSwitch", "GeometryNodeRepeatInput", "GeometryNodeRepeatOutput", "NodeClosureInput",
    "NodeClosureOutput", "NodeCombineBundle", "NodeEvaluateClosure", "NodeFrame", "NodeGroupInput", "NodeGroupOutput",
    "NodeReroute", "NodeSeparateBundle", "ShaderNodeCustomGroup", "ShaderNodeGroup", "ShaderNodeOutputAOV",
    "ShaderNodeOutputLight", "ShaderNodeOutputLineStyle", "ShaderNodeOutputMaterial", "ShaderNodeOutputWorld",
    "NodeComment", "ShaderNodeLightIterInternalOutput",
}  # fmt: skip

#: Cycles does not know them: they are shown as it shows them, and named (tests/addon/test_switches.py).
AS_IN_CYCLES = {
    "ShaderNodeEeveeSpecular", "ShaderNodeLightAccumulation", "ShaderNodeLightEvaluation", "ShaderNodeLightInfo",
    "ShaderNodeLightIterInternalInput", "ShaderNodeShaderToRGB", "ShaderNodeShadowRaycast", "ShaderNodeSqueeze",
    "ShaderNodeUVAlongStroke",
}  # fmt: skip

#: What the export says of some settings of nodes that it resolves.
PARTLY_RESOLVED = {
    "FunctionNodeFindInString": "modes but From Start are not supported → as if it were not linked",
    "FunctionNodeFormatString": "hexadecimal and escaped forms are not supported → as if it were not linked",
}


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


def notices(
    kind: str,
    output: str,
    is_shader: bool,
    inputs: Any,
    properties: Any,
    changed: Any = (),
    *,
    is_volume: bool = False,
) -> list[Notice]:
    """What is reported of one node whose `output` is seen, on a surface or as what is inside."""
    value = Node("ShaderNodeValue", "Value", {}, {"value": 0.5})
    node = Node(kind, "It", inputs, properties, frozenset(changed))
    graph = NodeGraph([value, node], surface=Link(1, output))
    if is_volume:
        graph.surface, graph.volume = None, Link(1, output)
    elif not is_shader:
        graph.nodes.append(Node("ShaderNodeEmission", "Emission", {"Color": Link(1, output)}))
        graph.surface = Link(2, "Emission")
    return compile_programs([ProgramSource("It", graph)], [])[2]


def settings_of(node: Any) -> dict[str, Any]:
    """All switches and enums of a node, whatever they are for."""
    common = set(bpy.types.ShaderNode.bl_rna.properties.keys())
    return {
        prop.identifier: prop
        for prop in node.bl_rna.properties
        if prop.identifier not in common and prop.type in ("ENUM", "BOOLEAN", "INT", "FLOAT", "STRING")
    }


def properties_of(node: Any) -> dict[str, Any]:
    """Values of `settings_of`, as the export gives them."""
    values = {name: getattr(node, name) for name in settings_of(node)}
    return {name: value if isinstance(value, (str, int, float)) else tuple(value) for name, value in values.items()} | {
        "value": (0.5, 0.5, 0.5, 1.0)
    }


def variants(tree: Any, kind: str) -> Iterator[Any]:
    """A new node, then one for each value of each of its enums: sockets come and go with them."""
    node = tree.nodes.new(kind)
    yield node
    for name, prop in settings_of(node).items():
        if prop.type != "ENUM" or prop.is_enum_flag:
            continue
        before = getattr(node, name)
        if not before:  # It offers what other nodes of the tree make.
            continue
        for item in prop.enum_items_static:
            try:
                setattr(node, name, item.identifier)
            except TypeError:  # Not offered to shaders.
                continue
            yield node
        setattr(node, name, before)
    tree.nodes.remove(node)
