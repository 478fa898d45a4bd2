# SPDX-License-Identifier: GPL-3.0-or-later
"""Entries of the node table for patterns that few scenes have (`engine/kernels/shader/ops_patterns.py`)."""

from __future__ import annotations

import math
from typing import Any

from engine.kernels.shader.ops_patterns import OP_GABOR, OP_RADIAL_TILING, link_patterns
from engine.scene.description import Node
from engine.shaders.options import flag, is_choice
from engine.shaders.table import FLOAT, VECTOR, Implicit, NodeTable, Operation, Socket


def _gabor(node: Node, builder: Any) -> Operation:
    link_patterns()
    inputs = (
        Socket("Vector", VECTOR, Implicit.GENERATED),
        Socket("Scale", FLOAT, 5.0),
        Socket("Frequency", FLOAT, 2.0),
        Socket("Anisotropy", FLOAT, 1.0),
        Socket("Orientation 2D", FLOAT, 0.25 * math.pi),
        Socket("Orientation 3D", VECTOR, (math.sqrt(2.0), math.sqrt(2.0), 0.0)),
    )
    outputs = (Socket("Value", FLOAT), Socket("Phase", FLOAT), Socket("Intensity", FLOAT))
    is_solid = is_choice(node, builder, "gabor_type", "3D", "2D", "2D")
    return Operation(OP_GABOR, inputs, outputs, (int(is_solid),))


def _radial_tiling(node: Node, builder: Any) -> Operation:
    link_patterns()
    inputs = (Socket("Vector", VECTOR, (0.0, 0.0, 0.0)), Socket("Sides", FLOAT, 5.0), Socket("Roundness", FLOAT, 0.0))
    outputs = (
        Socket("Segment Coordinates", VECTOR),
        Socket("Segment ID", FLOAT),
        Socket("Segment Width", FLOAT),
        Socket("Segment Rotation", FLOAT),
    )
    return Operation(OP_RADIAL_TILING, inputs, outputs, (flag(node, "normalize", False),))


NODES: NodeTable = {"ShaderNodeTexGabor": _gabor, "ShaderNodeRadialTiling": _radial_tiling}
