# SPDX-License-Identifier: GPL-3.0-or-later
"""Blender node trees to `NodeGraph`: groups, reroutes, muted nodes and older versions' sockets resolved."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from typing import Any

import bpy
import numpy as np

from engine.scene.description import Link, Node, NodeGraph

from ..versions import GROUPS_INLINED, MISSING_IMAGES_UNCLIPPED, is_since
from .context import ExportContext
from .images import ImageExporter
from .inlined_nodes import INLINED, Access
from .node_defaults import changed_parts
from .node_tables import bake_constant, bake_curves, bake_ramp
from .node_trees import Tree, open_tree
from .node_versions import modernize
from .object_properties import read_property
from .photometry import read_photometry
from .standard_attributes import UNREAD, attribute_name

#: Linear Rec.709 luminance: what a typed-in colour becomes on a float socket in any working space. Blender makes it so,
#: before Cycles sees it.
_LUMINANCE = (0.2126, 0.7152, 0.0722)

_BLACK = (0.0, 0.0, 0.0, 1.0)

_FLOAT_SOCKETS = ("VALUE", "INT", "BOOLEAN")
#: Nodes whose vectors Blender does not show, and has all the same: the surface supplies none.
_HIDDEN_VALUES = {"ShaderNodeMapRange", "ShaderNodeTexWhiteNoise", "ShaderNodeVectorRotate"}
_VALUE_SOCKETS = (*_FLOAT_SOCKETS, "VECTOR", "RGBA", "STRING", "ROTATION", "MENU")
_SIMPLE_PROPERTIES = ("ENUM", "BOOLEAN", "INT", "FLOAT", "STRING")
_OUTPUTS = ("ShaderNodeOutputMaterial", "ShaderNodeOutputLight", "ShaderNodeOutputWorld")
#: Nodes whose value is edited on their own output socket.
_VALUE_ON_OUTPUT = ("ShaderNodeValue", "ShaderNodeRGB", "ShaderNodeNormal")
#: Nodes that hand on what one of their inputs carries.
_PASSED = {"NodeReroute", "NodeGroupInput", *INLINED}
#: Nodes whose value is a property.
_VALUE_PROPERTY = {
    "FunctionNodeInputBool": "boolean",
    "FunctionNodeInputInt": "integer",
    "FunctionNodeInputVector": "vector",
}
#: A node's depth in a chain of nodes is a few Python frames.
_RECURSION_LIMIT = 100_000

#: What feeds an input: a link, a constant, or None where the surface supplies the value.
Source = Any


class GraphExporter:
    """Exports node trees of materials, lights and worlds."""

    def __init__(self, context: ExportContext, images: ImageExporter) -> None:
        self._context = context
        self._images = images
        self._graph = NodeGraph()
        self._subject = ""
        self._exported: dict[int, NodeGraph] = {}
        #: Addresses of original datablocks that the last tree was read from, besides its owner; and whether it shows
        #: something else too: the time, a property of the scene.
        self.reads: set[int] = set()
        self.reads_more = False
        self._access = Access(
            self._input, self._convert, self._notice, self._output, self._add,
            lambda source: _constant_of(self._graph, source),
        )  # fmt: skip

    def export(self, tree: bpy.types.NodeTree, subject: str) -> NodeGraph:
        """What the active output of `tree` depends on, in an order where a node follows its inputs.

        Parameters
        ----------
        subject : str
            Names the user of the tree in notices, as "Cube / Glass".
        """
        address = tree.as_pointer()
        if address in self._exported:
            return self._exported[address]
        self._graph = self._exported[address] = NodeGraph()
        self._subject = subject
        self.reads, self.reads_more = set(), False
        output = _active_output(tree)
        root = open_tree(tree, None, None)
        with _recursion():
            self._aovs(root)
            for socket in () if output is None else output.inputs:
                name = socket.identifier.lower()
                if name in ("surface", "volume", "displacement"):
                    source = self._linked(root, socket)
                    setattr(self._graph, name, source if isinstance(source, Link) else None)
        return self._graph

    def _aovs(self, tree: Tree) -> None:
        """AOV Output nodes of a tree and of its groups, of the AOVs that the view layer asks for."""
        if not self._context.aovs:
            return
        for node in tree.tree.nodes:
            if node.bl_idname == "ShaderNodeOutputAOV":
                # Blender mutes no outputs.
                if _aov_name(node) in self._context.aovs:
                    self._graph.aovs.append(self._node(tree, node))
            elif getattr(node, "node_tree", None) is not None and not node.mute:
                self._aovs(self._open_group(tree, node))

    # -----------------------------------------------------------------------------------------------------------------
    # Sockets

    def _input(self, tree: Tree, socket: bpy.types.NodeSocket) -> Source:
        """Link or constant of an input socket.

        As in Blender 5.0, the socket that a link ends at says what counts where Cycles does not know what it comes
        from; before, the first one on the way did, be it a group's.
        """
        source = self._linked(tree, socket)
        if source is None:
            return _constant(socket)
        if isinstance(source, Link) and (source.otherwise is None or is_since(GROUPS_INLINED)):
            return replace(source, otherwise=_constant(socket))
        return source

    def _linked(self, tree: Tree, socket: bpy.types.NodeSocket) -> Source:
        """What is linked to an input socket (a constant if a group hands one on), None if nothing is."""
        link = tree.links.get(socket.as_pointer())
        if link is None:
            if socket.as_pointer() in tree.broken:
                problem = f"has an invalid link into {socket.name}: part of a loop, or of a kind that does not fit"
                self._notice(socket.node, problem, "as if there were no link")
            return None
        source = self._output(tree, link.from_node, link.from_socket)
        return self._convert(source, link.from_socket.type, socket.type)

    def _output(self, tree: Tree, node: bpy.types.Node, socket: bpy.types.NodeSocket) -> Source:
        """What an output socket carries."""
        address, turn = node.as_pointer(), tree.turn
        if turn is not None and address not in turn.members:
            return self._output(turn.outer, node, socket)
        if turn is not None and address == turn.begin:
            return turn.value(socket)
        # Reroutes, muted nodes and group boundaries may form a loop of their own, without a node to stop at.
        passes = node.mute or node.bl_idname in _PASSED or hasattr(node, "node_tree")
        mark = socket.as_pointer() if passes else address
        if mark in tree.unfinished:
            self._notice(node, "is part of a loop of links", "the loop is cut open there")
            return None
        tree.unfinished.add(mark)
        try:
            if node.bl_idname == "NodeReroute":
                return self._through(tree, node.inputs[0], socket)
            if node.mute:
                return self._muted(tree, node, socket)
            if node.bl_idname == "NodeGroupInput":
                return self._group_input(tree, socket)
            if hasattr(node, "node_tree"):
                return self._group(tree, node, socket)
            if node.bl_idname in INLINED:
                if mark not in tree.carried:
                    tree.carried[mark] = INLINED[node.bl_idname](self._access, tree, node, socket)
                return tree.carried[mark]
            if address not in tree.finished:
                tree.finished[address] = self._node(tree, node)
            return _renamed_output(self._graph.nodes[tree.finished[address]], tree.finished[address], socket)
        finally:
            tree.unfinished.discard(mark)

    def _through(self, tree: Tree, inner: bpy.types.NodeSocket, outer: bpy.types.NodeSocket) -> Source:
        return self._convert(self._linked(tree, inner), inner.type, outer.type)

    def _muted(self, tree: Tree, node: bpy.types.Node, socket: bpy.types.NodeSocket) -> Source:
        """Blender says which input a muted node hands on to which output."""
        for internal in node.internal_links:
            if internal.to_socket == socket:
                return self._through(tree, internal.from_socket, socket)
        return None

    def _group_input(self, tree: Tree, socket: bpy.types.NodeSocket) -> Source:
        if tree.parent is None or tree.group is None:
            return None
        for outer in tree.group.inputs:
            if outer.identifier == socket.identifier:
                source = self._input(tree.parent, outer)
                return self._convert(source, outer.type, socket.type)
        return None

    def _group(self, tree: Tree, node: bpy.types.Node, socket: bpy.types.NodeSocket) -> Source:
        if node.node_tree is None:
            self._notice(node, "is a group without a node tree", "nothing comes out of it")
            return None
        inner = self._open_group(tree, node)
        for output in inner.tree.nodes:
            if output.bl_idname == "NodeGroupOutput" and output.is_active_output:
                for inside in output.inputs:
                    if inside.identifier == socket.identifier:
                        return self._convert(self._input(inner, inside), inside.type, socket.type)
        return None

    def _open_group(self, tree: Tree, node: bpy.types.Node) -> Tree:
        inner = tree.groups.get(node.as_pointer())
        if inner is None:
            self.reads.add(node.node_tree.original.as_pointer())
            inner = tree.groups[node.as_pointer()] = open_tree(node.node_tree, tree, node)
        return inner

    def _convert(self, source: Source, from_type: str, to_type: str) -> Source:
        """Make `source` what it becomes on a socket of another type.

        As in Blender 5.0, a link through groups and reroutes arrives as it set out, whatever the types of the sockets
        between; a typed-in value takes the type of every socket it passes. A node converts what it is linked to.
        """
        if source is None or from_type == to_type or to_type == "CUSTOM":
            return source
        if to_type == "SHADER":
            is_link = isinstance(source, Link)
            inputs = {"Color": replace(source, otherwise=_BLACK) if is_link else source, "Strength": 1.0}
            self._graph.nodes.append(Node("ShaderNodeEmission", "conversion", inputs, {"is_conversion": is_link}))
            return Link(len(self._graph.nodes) - 1, "Emission")
        if from_type == "SHADER":
            return None
        if isinstance(source, Link):
            if source.otherwise is None:
                return source
            return replace(source, otherwise=_convert_constant(source.otherwise, from_type, to_type))
        return _convert_constant(source, from_type, to_type)

    # -----------------------------------------------------------------------------------------------------------------
    # Nodes

    def _node(self, tree: Tree, node: bpy.types.Node) -> int:
        """Append a node after everything it depends on, and return its index."""
        inputs: dict[str, Any] = {}
        for socket in node.inputs:
            if socket.is_unavailable or not socket.enabled:
                continue
            source = self._input(tree, socket)
            if source is not None:
                inputs[socket.identifier] = source
        properties = self._properties(node)
        if node.bl_idname == "ShaderNodeRaycast":
            properties["attributes"] = self._attributes_of_hits(node, inputs)
        result = Node(node.bl_idname, node.name, inputs, properties, changed_parts(node, properties))
        self._graph.nodes.extend(modernize(result, len(self._graph.nodes)))
        return len(self._graph.nodes) - 1

    def _add(self, kind: str, output: str, inputs: dict[str, Any], properties: dict[str, Any]) -> Link:
        """A node that stands for others of the tree."""
        self._graph.nodes.append(Node(kind, "conversion", inputs, properties))
        return Link(len(self._graph.nodes) - 1, output)

    def _properties(self, node: bpy.types.Node) -> dict[str, Any]:
        properties: dict[str, Any] = {}
        for name, kind in _own_properties(node):
            if kind in _SIMPLE_PROPERTIES:
                value = getattr(node, name)
                if isinstance(value, set):
                    value = tuple(sorted(value))
                elif not isinstance(value, (str, int, float)):
                    value = tuple(value)
                properties[name] = value
        idname = node.bl_idname
        if idname == "ShaderNodeOutputAOV":
            properties["aov_name"] = _aov_name(node)
        elif idname in _VALUE_ON_OUTPUT:
            properties["value"] = _socket_value(node.outputs[0])
        elif idname in _VALUE_PROPERTY:
            properties["value"] = properties[_VALUE_PROPERTY[idname]]
        elif idname == "GeometryNodeInputSceneTime":
            properties.update(_scene_time(self._context.scene))
            self.reads_more = True
        elif idname == "ShaderNodeValToRGB":
            properties["ramp"] = bake_ramp(node.color_ramp)
            properties["interpolation"] = node.color_ramp.interpolation
            properties["interpolate"] = node.color_ramp.interpolation != "CONSTANT"
        elif idname in ("ShaderNodeRGBCurve", "ShaderNodeVectorCurve", "ShaderNodeFloatCurve"):
            properties.update(bake_curves(node.mapping, idname))
            is_constant = not any(socket.is_linked for socket in node.inputs)
            if idname == "ShaderNodeFloatCurve" and is_constant and is_since(GROUPS_INLINED):
                properties["curves"] = bake_constant(node.mapping, node.inputs["Value"].default_value)
        elif idname == "ShaderNodeAttribute" and node.attribute_type == "VIEW_LAYER":
            properties["value"] = self._view_layer_attribute(node.attribute_name)
            self.reads_more = True
        elif idname == "ShaderNodeAttribute" and node.attribute_type == "GEOMETRY":
            properties["attribute_name"] = self._mesh_attribute(node, node.attribute_name)
        elif idname == "ShaderNodeVertexColor":
            properties["layer_name"] = self._mesh_attribute(node, node.layer_name)
        elif idname == "ShaderNodeTexIES":
            properties["photometry"] = self._photometry(node)
        if hasattr(node, "image"):
            properties["image"] = index = self._image(node)
            if self._images.is_missing(index) and is_since(MISSING_IMAGES_UNCLIPPED):
                properties["extension"] = "REPEAT"
        if getattr(node, "object", None) is not None:
            self.reads.add(node.object.original.as_pointer())
            matrix = np.array(node.object.matrix_world, np.float64)
            if np.isfinite(matrix).all():
                properties["object_matrix"] = np.linalg.pinv(matrix).astype(np.float32)
            else:
                self._notice(node, f"refers to {node.object.name}, whose transform is not finite", "own coordinates")
        mapping = getattr(node, "texture_mapping", None)
        if mapping is not None and not _is_identity(mapping):
            self._notice(node, "has a texture mapping of its own, which is not supported", "coordinates as they come")
        return properties

    def _image(self, node: bpy.types.Node) -> int:
        subject = f"{self._subject} / {node.name}"
        if node.image is None:
            return -1
        self.reads.add(node.image.original.as_pointer())
        return self._images.export(node.image, node.image_user, subject)

    def _photometry(self, node: bpy.types.ShaderNodeTexIES) -> str:
        """Text of an IES file; '' if there is none, or none that can be read."""
        if node.mode == "INTERNAL" and node.ies is not None:
            self.reads.add(node.ies.original.as_pointer())
        try:
            return read_photometry(node)
        except ValueError as error:
            self._notice(node, str(error), "as without a file")
            return ""

    def _mesh_attribute(self, node: bpy.types.Node, name: str) -> str:
        if name in UNREAD:
            self._notice(node, f"attribute {name!r} is not supported", "0 everywhere")
        return attribute_name(name)

    def _attributes_of_hits(self, node: bpy.types.Node, inputs: dict[str, Any]) -> tuple[tuple[str, str, str], ...]:
        """Output, name and type of each attribute that a Raycast node reads where it hits; taken out of its inputs."""
        found = []
        for socket in node.outputs:
            name = inputs.get(socket.identifier.replace("Attribute_", "Value_"))
            if socket.identifier.startswith("Attribute_") and isinstance(name, str):
                found.append((socket.identifier, self._mesh_attribute(node, name), socket.type))
        for identifier in [key for key, value in inputs.items() if key.startswith("Value_") and isinstance(value, str)]:
            del inputs[identifier]
        return tuple(found)

    def _view_layer_attribute(self, name: str) -> tuple[float, float, float, float]:
        """A property of the view layer, scene or world; zeros if there is none."""
        context = self._context
        for owner in (context.view_layer, context.scene, context.scene.world):
            value = None if owner is None else read_property(owner, name)
            if value is not None:
                return value
        return (0.0, 0.0, 0.0, 0.0)

    def _notice(self, node: bpy.types.Node, problem: str, fallback: str) -> None:
        self._context.notice(f"{self._subject} / {node.name}", problem, fallback)


# ---------------------------------------------------------------------------------------------------------------------


@contextmanager
def _recursion() -> Iterator[None]:
    """Chains of nodes may be longer than Python's default limit of frames."""
    limit = sys.getrecursionlimit()
    sys.setrecursionlimit(max(limit, _RECURSION_LIMIT))
    try:
        yield
    finally:
        sys.setrecursionlimit(limit)


def _constant_of(graph: NodeGraph, source: Source) -> Any:
    """The value of a node that is nothing else, None of others."""
    if not isinstance(source, Link):
        return None
    node = graph.nodes[source.node]
    is_constant = node.kind in ("ShaderNodeValue", "ShaderNodeRGB") or node.kind in _VALUE_PROPERTY
    return node.properties.get("value") if is_constant else None


def _scene_time(scene: bpy.types.Scene) -> dict[str, float]:
    frame = scene.frame_current + scene.frame_subframe
    return {"frame": frame, "seconds": frame * scene.render.fps_base / scene.render.fps}


def _active_output(tree: bpy.types.NodeTree) -> bpy.types.Node | None:
    """The output Cycles would use: its own before one for all engines."""
    if hasattr(tree, "get_output_node"):
        output = tree.get_output_node("CYCLES")
        if output is not None:
            return output
    candidates = [node for node in tree.nodes if node.bl_idname in _OUTPUTS and node.target in ("ALL", "CYCLES")]
    candidates.sort(key=lambda node: (not node.is_active_output, node.target != "CYCLES"))
    return candidates[0] if candidates else None


def _aov_name(node: bpy.types.Node) -> str:
    """Older Blenders have it for the node's own name."""
    return getattr(node, "aov_name", node.name)


def _renamed_output(node: Node, index: int, socket: bpy.types.NodeSocket) -> Link:
    renames = node.properties.get("renamed_outputs")
    identifier = socket.identifier
    return Link(index, renames.get(identifier, identifier) if renames else identifier)


def _constant(socket: bpy.types.NodeSocket) -> Source:
    """The value typed into a socket; None if it has none, or if the surface supplies a default."""
    if socket.type not in _VALUE_SOCKETS:
        return None
    if socket.type == "VECTOR" and socket.hide_value and socket.node.bl_idname not in _HIDDEN_VALUES:
        return None
    return _socket_value(socket)


def _socket_value(socket: bpy.types.NodeSocket) -> Source:
    value = getattr(socket, "default_value", None)
    if value is None or isinstance(value, (str, bool, int, float)):
        return value
    if socket.type == "VECTOR":
        # Of two numbers or four, three count.
        return (*value, 0.0)[:3]
    return tuple(value)


def _convert_constant(value: Any, from_type: str, to_type: str) -> Any:
    if isinstance(value, tuple):
        red, green, blue = value[:3]
        if to_type == "BOOLEAN" and from_type != "RGBA":
            return any(value[:3])
        if to_type in _FLOAT_SOCKETS:
            weights = _LUMINANCE if from_type == "RGBA" else (1.0 / 3.0, 1.0 / 3.0, 1.0 / 3.0)
            value = red * weights[0] + green * weights[1] + blue * weights[2]
            return int(value) if to_type == "INT" else value > 0.0 if to_type == "BOOLEAN" else value
        return (red, green, blue, 1.0) if to_type == "RGBA" else (red, green, blue)
    if isinstance(value, str):
        return None
    if to_type == "VECTOR":
        return (float(value),) * 3
    if to_type == "RGBA":
        return (float(value),) * 3 + (1.0,)
    if to_type == "STRING":
        return None
    if to_type == "BOOLEAN":
        return value > 0
    return int(value) if to_type == "INT" else float(value)


_property_names: dict[str, list[tuple[str, str]]] = {}


def _own_properties(node: bpy.types.Node) -> list[tuple[str, str]]:
    """Name and type of the properties a node has besides those of every node."""
    kind = node.bl_idname
    if kind not in _property_names:
        common = set(bpy.types.ShaderNode.bl_rna.properties.keys())
        _property_names[kind] = [
            (prop.identifier, prop.type) for prop in node.bl_rna.properties if prop.identifier not in common
        ]
    return _property_names[kind]


def _is_identity(mapping: bpy.types.TexMapping) -> bool:
    # POINT and TEXTURE with unit transforms are the same.
    if (mapping.mapping_x, mapping.mapping_y, mapping.mapping_z) != ("X", "Y", "Z"):
        return False
    if any(mapping.translation) or any(mapping.rotation) or any(scale != 1.0 for scale in mapping.scale):
        return False
    return not (mapping.use_min or mapping.use_max)
