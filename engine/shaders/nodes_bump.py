# SPDX-License-Identifier: GPL-3.0-or-later
"""Nodes that need several instructions: Bump, which reads heights at displaced points, and those of displacement."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from engine.kernels.shader import normal_ops, ops_displacement
from engine.kernels.shader import ops_input as ops
from engine.scene.description import Link, Node
from engine.shaders.options import choice
from engine.shaders.program import Constant, Instruction, Value, is_zero
from engine.shaders.table import COLOR, FLOAT, VECTOR, Implicit, Socket


@dataclass(frozen=True)
class Composite:
    """A node whose only output, a vector, takes more than an `Operation`: `emit(node, builder)` gives its value."""

    output: str
    inputs: tuple[str, ...]
    emit: Callable[[Node, Any], Value]


def _bump(node: Node, builder: Any) -> Value:
    normal = builder.input(Socket("Normal", VECTOR, Implicit.NORMAL))
    height = node.inputs.get("Height")
    strength = builder.input(Socket("Strength", FLOAT, 1.0))
    distance = builder.input(Socket("Distance", FLOAT, 1.0))
    if not isinstance(height, Link) or is_zero(strength) or is_zero(distance):
        return normal
    width = builder.input(Socket("Filter Width", FLOAT, float(node.properties.get("filter_width", 0.1))))
    if not isinstance(width, Constant):
        builder.notice("has a Filter Width that is not constant", "0.1")
        width = Constant((0.1,))
    heights = []
    for axis in (0, 1, 2):
        heights.append(builder.displaced(axis, width.value[0]).input(Socket("Height", FLOAT, 1.0)))
    if len(set(heights)) == 1:
        return normal
    operands = (*heights, strength, distance, normal, width)
    immediates = (int(bool(node.properties.get("invert", False))), normal_ops.BUMPED_IN_WORLD)
    return builder.append(Instruction(ops.OP_BUMP, operands, (3,), immediates), is_varying=True)[0]


def _displacement(node: Node, builder: Any) -> Value:
    """Normal times (height - midlevel) times scale."""
    height = builder.input(Socket("Height", FLOAT, 0.0))
    midlevel = builder.input(Socket("Midlevel", FLOAT, 0.5))
    scale = builder.input(Socket("Scale", FLOAT, 1.0))
    normal = builder.input(Socket("Normal", VECTOR, Implicit.NORMAL))
    in_object_space = choice(node, builder, "space", ("WORLD", "OBJECT"), "OBJECT")
    operands = (height, midlevel, scale, normal)
    instruction = Instruction(ops_displacement.OP_DISPLACEMENT, operands, (3,), (in_object_space,))
    return builder.append(instruction, is_varying=True)[0]


_SPACES = {
    "TANGENT": ops_displacement.DISPLACED_IN_TANGENT,
    "OBJECT": ops_displacement.DISPLACED_IN_OBJECT,
    "WORLD": ops_displacement.DISPLACED_IN_WORLD,
}


def _vector_displacement(node: Node, builder: Any) -> Value:
    """(Vector - midlevel) times scale, along tangent, normal and bitangent or along axes."""
    operands = (
        builder.input(Socket("Vector", COLOR, (0.0, 0.0, 0.0))),
        builder.input(Socket("Midlevel", FLOAT, 0.0)),
        builder.input(Socket("Scale", FLOAT, 1.0)),
    )
    space = choice(node, builder, "space", _SPACES, "TANGENT")
    tangent_slot, uv_slot = (builder.attribute_slot(".tangent"), -1) if space == _SPACES["TANGENT"] else (-3, -3)
    instruction = Instruction(ops_displacement.OP_VECTOR_DISPLACEMENT, operands, (3,), (space, tangent_slot, uv_slot))
    return builder.append(instruction, is_varying=True)[0]


_OFFSET = ("Vector", "Midlevel", "Scale")

COMPOSITES: dict[str, Composite] = {
    "ShaderNodeBump": Composite("Normal", ("Strength", "Distance", "Filter Width", "Height", "Normal"), _bump),
    "ShaderNodeDisplacement": Composite("Displacement", ("Height", "Midlevel", "Scale", "Normal"), _displacement),
    "ShaderNodeVectorDisplacement": Composite("Displacement", _OFFSET, _vector_displacement),
}
