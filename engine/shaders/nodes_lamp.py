# SPDX-License-Identifier: GPL-3.0-or-later
"""What nodes read of a lamp: its own space, and its object's facts, known when its program is compiled."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from engine.kernels.shader import ops_input as ops
from engine.scene.description import Node
from engine.shaders.table import COLOR, FLOAT, VECTOR, Implicit, Operation, Socket, SocketType

Lowering = Callable[[Node, Any], Operation]


def or_of_lamp(otherwise: Lowering, of_lamp: Lowering) -> Lowering:
    """`of_lamp` where a lamp's program asks for facts of it, which `builder.lamp` are then; `otherwise` elsewhere."""
    return lambda node, builder: (otherwise if builder.lamp is None else of_lamp)(node, builder)


def _transform(builder: Any, source: Socket, output: str, matrix: np.ndarray, *, is_unit: bool = False) -> Operation:
    """A vector times a matrix, (3, 4) or (3, 3), made a unit vector if wanted."""
    table = np.zeros((3, 4))
    table[:, : matrix.shape[1]] = matrix
    outputs = (Socket(output, VECTOR),)
    return Operation(ops.OP_TRANSFORM_POINT, (source,), outputs, (builder.add_table(table), int(is_unit)))


def local_place(node: Node, builder: Any) -> Operation:
    """Place in the lamp's own space."""
    return _transform(builder, Socket("", VECTOR, Implicit.POSITION), "", builder.lamp.to_local)


def local_normal(node: Node, builder: Any) -> Operation:
    """Normal in the lamp's own space."""
    return _transform(builder, Socket("", VECTOR, Implicit.NORMAL), "", np.array(builder.lamp.axes), is_unit=True)


def local_incoming(node: Node, builder: Any) -> Operation:
    """Direction in which light leaves, as a normal of the lamp's own space."""
    return _transform(builder, Socket("", VECTOR, Implicit.INCOMING), "", np.array(builder.lamp.axes), is_unit=True)


def location(node: Node, builder: Any) -> Operation:
    """Where the lamp is."""
    return _constant(builder.lamp.location, VECTOR)


def color(node: Node, builder: Any) -> Operation:
    """Colour of the lamp's object."""
    return _constant(builder.lamp.color[:3], COLOR)


def alpha(node: Node, builder: Any) -> Operation:
    """Alpha of that colour."""
    return _constant(builder.lamp.color[3], FLOAT)


def pass_index(node: Node, builder: Any) -> Operation:
    """Pass index of the lamp's object."""
    return _constant(float(builder.lamp.pass_index), FLOAT)


def random(node: Node, builder: Any) -> Operation:
    """Number of the lamp's object, in [0, 1)."""
    return _constant(builder.lamp.random, FLOAT)


def _constant(value: float | tuple[float, ...], type_: SocketType) -> Operation:
    return Operation(-1, (Socket("", type_, value),), (Socket("", type_),))


def transform_by_lamp(builder: Any, source: Socket, kind: str, *, to_lamp: bool) -> Operation:
    """Vector Transform between the world and the lamp's own space; `kind` as the node's vector_type."""
    lamp = builder.lamp
    matrix = lamp.to_local if to_lamp else lamp.to_world
    if kind == "NORMAL":
        axes = np.array(lamp.axes)
        matrix = axes if to_lamp else np.linalg.pinv(axes)
    elif kind == "VECTOR":
        matrix = matrix[:, :3]
    return _transform(builder, source, "Vector", matrix, is_unit=kind == "NORMAL")
