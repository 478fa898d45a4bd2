# SPDX-License-Identifier: GPL-3.0-or-later
"""Entries of the node table for nodes that trace rays, and for Wireframe."""

from __future__ import annotations

from typing import Any

from engine.kernels.shader import ops_rays as ops
from engine.scene.description import Link, Node
from engine.shaders.options import flag
from engine.shaders.program import Instruction, Value
from engine.shaders.table import COLOR, FLOAT, VECTOR, Implicit, NodeTable, Operation, Socket, SocketType

_NORMAL = Socket("Normal", VECTOR, Implicit.NORMAL)
#: Outputs of Raycast that no node has: where the hit is.
HIT_OUTPUTS = ("\0hit", "\0place")
#: Blender's own limit.
_MOST_SAMPLES = 128


def _constants(*outputs: Socket) -> Operation:
    """Outputs that are their defaults, whatever is linked."""
    return Operation(-1, tuple(Socket("", socket.type, socket.default) for socket in outputs), outputs)


def _samples(node: Node, default: int) -> int:
    return min(int(node.properties.get("samples", default)), _MOST_SAMPLES)


def _occlusion(node: Node, builder: Any) -> Operation:
    outputs = (Socket("Color", COLOR), Socket("AO", FLOAT, 1.0))
    color = Socket("Color", COLOR, (1.0, 1.0, 1.0))
    if builder.is_inside:
        return Operation(-1, (color, Socket("", FLOAT, 1.0)), outputs)
    flags = ops.OCCLUSION_INSIDE if flag(node, "inside", False) else 0
    flags |= ops.OCCLUSION_LOCAL if flag(node, "only_local", False) else 0
    distance = node.inputs.get("Distance", 1.0)
    if not isinstance(distance, Link) and distance == 0.0:
        flags |= ops.OCCLUSION_OF_WORLD
    inputs = (color, Socket("Distance", FLOAT, 1.0), _NORMAL)
    immediates = (_samples(node, 16), flags, builder.index)
    return Operation(ops.OP_OCCLUSION, inputs, outputs, immediates, is_varying=True)


def _bevel(node: Node, builder: Any) -> Operation:
    outputs = (Socket("Normal", VECTOR),)
    if builder.is_inside:
        return Operation(-1, (Socket("", VECTOR, Implicit.NORMAL),), outputs)
    inputs = (Socket("Radius", FLOAT, 0.05), _NORMAL)
    return Operation(ops.OP_BEVEL, inputs, outputs, (_samples(node, 4), builder.index), is_varying=True)


def _raycast(node: Node, builder: Any) -> Operation:
    outputs = (
        Socket("Is Hit", FLOAT), Socket("Self Hit", FLOAT), Socket("Hit Distance", FLOAT),
        Socket("Hit Position", VECTOR, (0.0, 0.0, 0.0)), Socket("Hit Normal", VECTOR, (0.0, 0.0, 0.0)),
    )  # fmt: skip
    length = Socket("Length", FLOAT, 1.0)
    if builder.is_inside:
        zero = Socket("", VECTOR, (0.0, 0.0, 0.0))
        return Operation(-1, (Socket("", FLOAT), Socket("", FLOAT), length, zero, zero), outputs)
    hidden = tuple(Socket(name, VECTOR) for name in HIT_OUTPUTS)
    inputs = (
        Socket("Position", VECTOR, Implicit.POSITION), Socket("Direction", VECTOR, Implicit.NORMAL), length,
        Socket("", FLOAT, builder.filter_width),
    )  # fmt: skip
    immediates = (flag(node, "only_local", False),)
    return Operation(ops.OP_RAYCAST, inputs, (*outputs, *hidden), immediates, is_varying=True)


def hit_attributes(node: Node, builder: Any, hit: Value, place: Value) -> dict[str, tuple[Value, SocketType]]:
    """What a Raycast node reads where its ray hits, by output.

    Parameters
    ----------
    hit, place : Value
        What OP_RAYCAST says of where that is.
    """
    found: dict[str, tuple[Value, SocketType]] = {}
    for output, name, kind in node.properties.get("attributes", ()):
        instruction = Instruction(ops.OP_HIT_ATTRIBUTE, (hit, place), (3, 1, 1), (builder.attribute_slot(name),))
        vector, fac, alpha = builder.append(instruction, is_varying=True)
        found[output] = (fac, FLOAT) if kind == "VALUE" else (vector, COLOR if kind == "RGBA" else VECTOR)
        found[f"{output}_Alpha"] = alpha, FLOAT
    return found


def _wireframe(node: Node, builder: Any) -> Operation:
    outputs = (Socket("Fac", FLOAT),)
    if builder.is_inside:
        return _constants(*outputs)
    inputs = (Socket("Size", FLOAT, 0.01), Socket("", FLOAT, builder.filter_width))
    immediates = (builder.axis, flag(node, "use_pixel_size", False))
    return Operation(ops.OP_WIREFRAME, inputs, outputs, immediates, is_varying=True)


NODES: NodeTable = {
    "ShaderNodeAmbientOcclusion": _occlusion,
    "ShaderNodeBevel": _bevel,
    "ShaderNodeRaycast": _raycast,
    "ShaderNodeWireframe": _wireframe,
}
