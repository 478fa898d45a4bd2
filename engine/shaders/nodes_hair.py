# SPDX-License-Identifier: GPL-3.0-or-later
"""Shader nodes of hair: see `nodes_closure`."""

from __future__ import annotations

from typing import Any

from engine.kernels.bsdf.chiang import CHIANG_ABSORPTION, CHIANG_COLOR, CHIANG_MELANIN
from engine.kernels.shader import ops_closure as ops
from engine.scene.description import Link, Node
from engine.shaders.options import choice
from engine.shaders.program import Value
from engine.shaders.table import COLOR, FLOAT, VECTOR, Implicit, Socket
from engine.state.shaders import MODE_CLOSURES

_COMPONENTS = {"Reflection": 0, "Transmission": 1}
_COLORS = {"ABSORPTION": CHIANG_ABSORPTION, "MELANIN": CHIANG_MELANIN, "COLOR": CHIANG_COLOR}
_MODELS = {"CHIANG": 0, "HUANG": 1}

#: Inputs of both nodes; of the second also those that only Huang's model has.
HAIR_INPUTS = ("Color", "Offset", "RoughnessU", "RoughnessV", "Tangent")
PRINCIPLED_HAIR_INPUTS = (
    "Color", "Melanin", "Melanin Redness", "Tint", "Absorption Coefficient", "Aspect Ratio", "Roughness",
    "Radial Roughness", "Coat", "IOR", "Offset", "Random Color", "Random Roughness", "Random", "R lobe", "TT lobe",
    "TRT lobe",
)  # fmt: skip


def hair(node: Node, weight: Value, builder: Any) -> None:
    """Hair BSDF."""
    operands = (
        builder.input(Socket("Color", COLOR, (0.8, 0.8, 0.8))),
        builder.input(Socket("RoughnessU", FLOAT, 0.1)),
        builder.input(Socket("RoughnessV", FLOAT, 1.0)),
        builder.input(Socket("Offset", FLOAT, 0.0)),
        builder.input(Socket("Tangent", VECTOR, (0.0, 0.0, 0.0))),
    )
    component = choice(node, builder, "component", _COMPONENTS, "Reflection")
    builder.closure(ops.opcode("HAIR"), weight, operands, (component,), modes=(MODE_CLOSURES,))


def principled_hair(node: Node, weight: Value, builder: Any) -> None:
    """Principled Hair BSDF."""
    is_huang = choice(node, builder, "model", _MODELS, "CHIANG") == _MODELS["HUANG"]
    if is_huang:
        builder.notice("Huang's model of hair is not supported", "Chiang's, as rough around the fibre as along it")
    mode = choice(node, builder, "parametrization", _COLORS, "COLOR")
    color = Socket("Color", COLOR, (0.017513, 0.005763, 0.002059))
    if mode == CHIANG_ABSORPTION:
        color = Socket("Absorption Coefficient", VECTOR, (0.245531, 0.52, 1.365))
    numbers = {
        "Melanin": 0.8,
        "Melanin Redness": 1.0,
        "Random Color": 0.0,
        "Roughness": 0.3,
        "Radial Roughness": 0.3,
        "Random Roughness": 0.0,
        "Coat": 0.0,
        "Offset": 0.0349066,
        "IOR": 1.55,
    }
    around = "Roughness" if is_huang else "Radial Roughness"
    names = (
        "Melanin", "Melanin Redness", "Random Color", "Roughness", around, "Random Roughness", "Coat", "Offset", "IOR",
    )  # fmt: skip
    # Its own value does not count, as in Cycles.
    is_linked = isinstance(node.inputs.get("Random"), Link)
    operands = (
        builder.input(color),
        builder.input(Socket("Tint", COLOR, (1.0, 1.0, 1.0))),
        *(builder.input(Socket(name, FLOAT, numbers[name])) for name in names),
        builder.input(Socket("Random" if is_linked else "\0random", FLOAT, Implicit.CURVE_RANDOM)),
    )
    builder.closure(ops.opcode("CHIANG"), weight, operands, (mode,), modes=(MODE_CLOSURES,))
