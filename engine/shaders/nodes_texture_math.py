# SPDX-License-Identifier: GPL-3.0-or-later
"""Entries of the node table for procedural textures and for operations on numbers, vectors and colours."""

from __future__ import annotations

from typing import Any

from engine.kernels.shader.ops_math import OP_CLAMP, OP_COMBINE_XYZ, OP_INVERT
from engine.kernels.shader.ops_texture import OP_CHECKER
from engine.scene.description import Node
from engine.shaders.table import COLOR, FLOAT, VECTOR, Implicit, NodeTable, Operation, Socket


def _clamp(node: Node, builder: Any) -> Operation:
    is_range = node.properties.get("clamp_type", "MINMAX") == "RANGE"
    inputs = (Socket("Value", FLOAT, 1.0), Socket("Min", FLOAT, 0.0), Socket("Max", FLOAT, 1.0))
    return Operation(OP_CLAMP, inputs, (Socket("Result", FLOAT),), immediates=(int(is_range),))


NODES: NodeTable = {
    "ShaderNodeClamp": _clamp,
    "ShaderNodeCombineXYZ": Operation(
        OP_COMBINE_XYZ,
        (Socket("X", FLOAT), Socket("Y", FLOAT), Socket("Z", FLOAT)),
        (Socket("Vector", VECTOR),),
    ),
    "ShaderNodeInvert": Operation(
        OP_INVERT,
        (Socket("Fac", FLOAT, 1.0), Socket("Color", COLOR, (0.0, 0.0, 0.0))),
        (Socket("Color", COLOR),),
    ),
    "ShaderNodeTexChecker": Operation(
        OP_CHECKER,
        (
            Socket("Vector", VECTOR, Implicit.GENERATED),
            Socket("Color1", COLOR, (0.8, 0.8, 0.8)),
            Socket("Color2", COLOR, (0.2, 0.2, 0.2)),
            Socket("Scale", FLOAT, 5.0),
        ),
        (Socket("Color", COLOR), Socket("Fac", FLOAT)),
    ),
}
