# SPDX-License-Identifier: GPL-3.0-or-later
"""Nodes of materials and worlds that emit light: which there are, and how what they emit is multiplied."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple

import bpy

#: What a node that multiplies is called; the next time its factor is changed instead of adding another.
_LABEL = "Light Mix"
_OUTPUTS = {"OUTPUT_MATERIAL", "OUTPUT_WORLD"}


class _Emission(NamedTuple):
    """Sockets by name: what is emitted is a strength times a colour, or, where there is no strength, a tint."""

    strengths: tuple[str, ...]
    colors: tuple[str, ...]
    tints: tuple[str, ...] = ()


#: By type of node. Blender 3 calls the Principled BSDF's colour by another name.
_EMISSIONS = {
    "EMISSION": _Emission(("Strength",), ("Color",)),
    "BACKGROUND": _Emission(("Strength",), ("Color",)),
    "BSDF_PRINCIPLED": _Emission(("Emission Strength",), ("Emission Color", "Emission")),
    # The intensity of its black body is no factor.
    "PRINCIPLED_VOLUME": _Emission(("Emission Strength",), ("Emission Color",), ("Blackbody Tint",)),
    "VOLUME_COEFFICIENTS": _Emission((), (), ("Emission Coefficients",)),
}
#: Switches of what a tint is of.
_TINTED_BY = {"Blackbody Tint": "Blackbody Intensity"}


def _sockets(node: Any, names: tuple[str, ...]) -> list[Any]:
    return [node.inputs[name] for name in names if name in node.inputs]


def _is_black(socket: Any) -> bool:
    """Whether an input is 0 for sure."""
    if socket.is_linked:
        return False
    value = socket.default_value
    return not any(value[:3]) if hasattr(value, "__len__") else value == 0.0


def _emits(node: Any) -> bool:
    emission = _EMISSIONS[node.type]
    strengths, colors = _sockets(node, emission.strengths), _sockets(node, emission.colors)
    if (strengths or colors) and not any(map(_is_black, strengths)) and not all(map(_is_black, colors)):
        return True
    tints = _sockets(node, emission.tints)
    switches = [node.inputs.get(_TINTED_BY.get(tint.name, "")) for tint in tints]
    return any(
        not _is_black(tint) and (switch is None or not _is_black(switch)) for tint, switch in zip(tints, switches)
    )


def _upstream(nodes: list[Any]) -> Iterator[Any]:
    """Nodes and what they are linked from, each once, without muted ones."""
    seen: set[str] = set()
    pending = list(nodes)
    while pending:
        node = pending.pop()
        if node.name in seen or node.mute:
            continue
        seen.add(node.name)
        yield node
        for socket in node.inputs:
            if socket.name != "Displacement" or node.type not in _OUTPUTS:
                pending += [link.from_node for link in socket.links if not link.is_muted]


def _emitting(tree: Any, ends: list[Any], trees: tuple[Any, ...] = ()) -> Iterator[tuple[Any, Any]]:
    """Nodes that emit, each with the outermost node that it is in: itself, or a group."""
    for node in _upstream(ends):
        if node.type in _EMISSIONS:
            if _emits(node):
                yield node, node
        elif node.type == "GROUP" and node.node_tree is not None and node.node_tree not in trees:
            inner = node.node_tree
            outputs = [one for one in inner.nodes if one.type == "GROUP_OUTPUT" and one.is_active_output]
            for found, _ in _emitting(inner, outputs, (*trees, tree)):
                yield found, node


def emitting_nodes(tree: bpy.types.ShaderNodeTree | None) -> list[tuple[bpy.types.Node, bpy.types.Node]]:
    """Nodes of a material or world that emit light, each with the node that it is within: itself, or a node group."""
    if tree is None:
        return []
    output = tree.get_output_node("CYCLES")
    return [] if output is None else list(_emitting(tree, [output]))


def emission_sockets(node: bpy.types.Node) -> list[bpy.types.NodeSocket]:
    """Inputs that say how much light a node emits."""
    emission = _EMISSIONS[node.type]
    return _sockets(node, emission.strengths + emission.colors + emission.tints)


def multiply_emission(
    tree: bpy.types.ShaderNodeTree, node: bpy.types.Node, strength: float, color: tuple[float, float, float]
) -> None:
    """Have a node of `emitting_nodes` emit `strength` times `color` as much; what is linked gets a node between."""
    emission = _EMISSIONS[node.type]
    both = tuple(strength * channel for channel in color)
    for names, factor in ((emission.strengths, (strength,) * 3), (emission.colors, color), (emission.tints, both)):
        for socket in _sockets(node, names):
            if factor != (1.0, 1.0, 1.0):
                _multiply(tree, socket, factor)


def _multiply(tree: Any, socket: Any, factor: tuple[float, ...]) -> None:
    value = socket.default_value
    is_number = not hasattr(value, "__len__")
    if not socket.is_linked:
        if is_number:
            socket.default_value = value * factor[0]
        else:
            for index, one in enumerate(factor):
                value[index] *= one
        return
    link = socket.links[0]
    between = link.from_node
    if between.label != _LABEL or between.inputs[1].is_linked:
        source = link.from_socket
        between = tree.nodes.new("ShaderNodeMath" if is_number else "ShaderNodeVectorMath")
        between.operation, between.label = "MULTIPLY", _LABEL
        between.location = (socket.node.location.x - 200.0, socket.node.location.y)
        between.inputs[1].default_value = 1.0 if is_number else (1.0, 1.0, 1.0)
        tree.links.new(source, between.inputs[0])
        tree.links.new(between.outputs[0], socket)
    _multiply(tree, between.inputs[1], factor)
