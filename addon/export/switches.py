# SPDX-License-Identifier: GPL-3.0-or-later
"""Switches, whole numbers and truth in materials (Blender 5.3), see `inlined_nodes`.

Where a condition is constant, what it chooses is linked. Where it varies, a switch is a mix by zeros and ones.
"""

from __future__ import annotations

from typing import Any

import bpy

from engine.scene.description import Link

from .integers import constant_integer, constant_truth, varying_integer, varying_truth
from .node_trees import Tree

#: Of a type of sockets: the Mix node's data type, how its sockets are called, and what counts where nothing is chosen.
_MIXED = {
    "VALUE": ("FLOAT", "Float", 0.0),
    "INT": ("FLOAT", "Float", 0.0),
    "BOOLEAN": ("FLOAT", "Float", 0.0),
    "VECTOR": ("VECTOR", "Vector", (0.0, 0.0, 0.0)),
    "RGBA": ("RGBA", "Color", (0.0, 0.0, 0.0, 1.0)),
}


class _Values:
    """What the sockets of one node carry, and nodes that are made of it."""

    def __init__(self, access: Any, tree: Tree, node: bpy.types.Node) -> None:
        self._access, self._tree, self.node = access, tree, node

    def given(self, socket: bpy.types.NodeSocket) -> Any:
        """What an input carries; constants that are a node of their own as constants."""
        value = self._access.input(self._tree, socket)
        constant = self._access.constant(value)
        if constant is None:
            return value
        link = self._tree.links[socket.as_pointer()]
        return self._access.convert(constant, link.from_socket.type, socket.type)

    def math(self, operation: str, *values: Any) -> Link:
        """A Math node."""
        inputs = dict(zip(("Value", "Value_001", "Value_002"), values, strict=False))
        return self._access.add("ShaderNodeMath", "Value", inputs, {"operation": operation, "use_clamp": False})

    def converted(self, inner: bpy.types.NodeSocket, outer: bpy.types.NodeSocket) -> Any:
        """What an input carries, as another socket has it."""
        return self.typed(self._access.convert(self.given(inner), inner.type, outer.type), inner)

    def typed(self, value: Any, socket: bpy.types.NodeSocket) -> Any:
        """Truth of what varies; other links arrive as they set out, as in Cycles."""
        return self.truth(socket) if socket.type == "BOOLEAN" and isinstance(value, Link) else value

    def truth(self, socket: bpy.types.NodeSocket) -> Any:
        """A condition: a bool, or a link to zeros and ones. Numbers above zero are true, and vectors that are not 0."""
        value = self.given(socket)
        if not isinstance(value, Link):
            return value is not None and value > 0
        link = self._tree.links.get(socket.as_pointer())
        if link is not None and link.from_socket.type == "VECTOR":
            inputs, properties = {"Vector": value}, {"operation": "LENGTH"}
            value = self._access.add("ShaderNodeVectorMath", "Value", inputs, properties)
        return self.math("GREATER_THAN", value, 0.0)

    def integer(self, socket: bpy.types.NodeSocket) -> Any:
        """A whole number: an int, or a link to numbers without a fraction."""
        value = self.given(socket)
        return self.math("TRUNC", value) if isinstance(value, Link) else int(value or 0)

    def mix(self, factor: Link, first: Any, second: Any, kind: str) -> Any:
        """The second value where the factor is one; None: values of this type cannot vary."""
        if kind == "SHADER":
            inputs = {"Fac": factor, "Shader": first, "Shader_001": second}
            given = {name: value for name, value in inputs.items() if value is not None}
            return self._access.add("ShaderNodeMixShader", "Shader", given, {})
        if kind not in _MIXED:
            self.unsupported(f"chooses a {kind.lower()} that varies")
            return None
        data_type, name, _ = _MIXED[kind]
        inputs = {"Factor_Float": factor, f"A_{name}": first, f"B_{name}": second}
        properties = {
            "data_type": data_type, "factor_mode": "UNIFORM", "blend_type": "MIX", "clamp_factor": True,
            "clamp_result": False,
        }  # fmt: skip
        return self._access.add("ShaderNodeMix", f"Result_{name}", inputs, properties)

    def chosen(self, index: Any, values: list[Any], kind: str) -> Any:
        """One of several values by its index; nothing, which is zero, beyond them."""
        result = nothing(kind)
        if not isinstance(index, Link):
            return values[index] if 0 <= index < len(values) else result
        for number, value in enumerate(values):
            result = self.mix(self.math("COMPARE", index, float(number), 0.5), result, value, kind)
        return result

    def unsupported(self, problem: str) -> None:
        """Say that a node has something that is not supported."""
        self._access.notice(self.node, problem, "as if it were not linked")


def nothing(kind: str) -> Any:
    """What a socket of a type carries where nothing is chosen."""
    return _MIXED[kind][2] if kind in _MIXED else None


def switch(access: Any, tree: Tree, node: bpy.types.Node, socket: bpy.types.NodeSocket) -> Any:
    """Switch: one of two by a condition."""
    values = _Values(access, tree, node)
    condition = values.truth(node.inputs[0])
    offered = {item.identifier: item for item in node.inputs if item.enabled and not item.is_unavailable}
    if not isinstance(condition, Link):
        return values.converted(offered["True" if condition else "False"], socket)
    first, second = (values.converted(offered[name], socket) for name in ("False", "True"))
    return values.mix(condition, first, second, socket.type)


def index_switch(access: Any, tree: Tree, node: bpy.types.Node, socket: bpy.types.NodeSocket) -> Any:
    """Index Switch: one of several by a number."""
    values = _Values(access, tree, node)
    items = [item for item in node.inputs[1:] if item.type != "CUSTOM"]
    index = values.integer(node.inputs[0])
    if not isinstance(index, Link):
        return values.converted(items[index], socket) if 0 <= index < len(items) else nothing(socket.type)
    return values.chosen(index, [values.converted(item, socket) for item in items], socket.type)


def enable_output(access: Any, tree: Tree, node: bpy.types.Node, socket: bpy.types.NodeSocket) -> Any:
    """Enable Output: a value, or nothing."""
    values = _Values(access, tree, node)
    condition = values.truth(node.inputs[0])
    if not isinstance(condition, Link):
        return values.converted(node.inputs[1], socket) if condition else nothing(socket.type)
    return values.mix(condition, nothing(socket.type), values.converted(node.inputs[1], socket), socket.type)


def implicit_conversion(access: Any, tree: Tree, node: bpy.types.Node, socket: bpy.types.NodeSocket) -> Any:
    """Implicit Conversion: a value as a socket of another type has it."""
    return _Values(access, tree, node).converted(node.inputs[0], socket)


def vector_component(access: Any, tree: Tree, node: bpy.types.Node, socket: bpy.types.NodeSocket) -> Any:
    """Get Vector Component: one of three numbers."""
    values = _Values(access, tree, node)
    vector = values.given(node.inputs[0])
    if isinstance(vector, Link):
        axes = [access.add("ShaderNodeSeparateXYZ", axis, {"Vector": vector}, {}) for axis in "XYZ"]
    else:
        axes = [0.0] * 3 if vector is None else list(vector[:3])
    return values.chosen(values.integer(node.inputs[1]), axes, "VALUE")


def boolean_math(access: Any, tree: Tree, node: bpy.types.Node, socket: bpy.types.NodeSocket) -> Any:
    """Boolean Math."""
    values = _Values(access, tree, node)
    a, b = [*(values.truth(item) for item in node.inputs if not item.is_unavailable), False][:2]
    if isinstance(a, Link) or isinstance(b, Link):
        result = varying_truth(values.math, node.operation, *(_number(value) for value in (a, b)))
    else:
        result = constant_truth(node.operation, a, b)
    if result is None:
        values.unsupported(f"has the operation {node.operation!r}, which is not supported")
    return result


def integer_math(access: Any, tree: Tree, node: bpy.types.Node, socket: bpy.types.NodeSocket) -> Any:
    """Integer Math."""
    values = _Values(access, tree, node)
    given = [*(values.integer(item) for item in node.inputs if not item.is_unavailable), 0, 0][:3]
    if any(isinstance(value, Link) for value in given):
        result = varying_integer(values.math, node.operation, *(_number(value) for value in given))
    else:
        result = constant_integer(node.operation, *given)
    if result is None:
        values.unsupported(f"has the operation {node.operation!r}, which is not supported")
    return result


def _number(value: Any) -> Any:
    return value if isinstance(value, Link) else float(value)


def warning(access: Any, tree: Tree, node: bpy.types.Node, socket: bpy.types.NodeSocket) -> Any:
    """Warning: hands on whether it is shown, where that is constant."""
    condition = _Values(access, tree, node).truth(node.inputs[0])
    return False if isinstance(condition, Link) else condition
