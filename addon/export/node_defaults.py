# SPDX-License-Identifier: GPL-3.0-or-later
"""What has been changed about a node, for Blenders newer than the add-on: they may have what it does not know."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import bpy

from ..versions import NEWEST_KNOWN, is_newer

#: What a new node of each kind has, by name: inputs, then settings.
_new_nodes: dict[str, tuple[dict[str, Any], dict[str, Any]]] = {}


def changed_parts(node: bpy.types.Node, properties: dict[str, Any]) -> frozenset[str]:
    """Names of a node's inputs and `properties` that are not those of a new node; none where Blender is known."""
    if not is_newer(NEWEST_KNOWN):
        return frozenset()
    kind = node.bl_idname
    if kind not in _new_nodes:
        _new_nodes[kind] = _new_node(kind, properties)
    inputs, settings = _new_nodes[kind]
    changed = {socket.identifier for socket in node.inputs if _value(socket) != inputs.get(socket.identifier)}
    # What the export adds is no setting.
    names = properties.keys() & node.bl_rna.properties.keys()
    changed |= {name for name in names if _plain(getattr(node, name)) != settings.get(name)}
    return frozenset(changed)


def _new_node(kind: str, names: Iterable[str]) -> tuple[dict[str, Any], dict[str, Any]]:
    """Blender says what a new node has only by making one: its properties' own defaults are other ones."""
    tree = bpy.data.node_groups.new("NeuralGuide", "ShaderNodeTree")
    try:
        node = tree.nodes.new(kind)
        inputs = {socket.identifier: _value(socket) for socket in node.inputs}
        return inputs, {name: _plain(getattr(node, name)) for name in names if hasattr(node, name)}
    except RuntimeError:
        return {}, {}
    finally:
        # Nobody uses it, and unlinking is unsafe in the middle of an animation's render (see images).
        bpy.data.node_groups.remove(tree, do_unlink=False)


def _value(socket: bpy.types.NodeSocket) -> Any:
    return _plain(getattr(socket, "default_value", None))


def _plain(value: Any) -> Any:
    """A value that can be compared and kept: arrays as tuples."""
    if value is None or isinstance(value, (str, bool, int, float, set)):
        return value
    return tuple(value) if hasattr(value, "__len__") else None
