# SPDX-License-Identifier: GPL-3.0-or-later
"""Shader nodes of hair: see `nodes_closure`."""

from __future__ import annotations

from typing import Any

from engine.kernels.bsdf.fibre_color import FIBRE_ABSORPTION, FIBRE_COLOR, FIBRE_MELANIN
from engine.kernels.shader import ops_closure as ops
from engine.scene.description import Link, Node
from engine.shaders.options import choice
from engine.shaders.program import Constant, Value
from engine.shaders.table import COLOR, FLOAT, VECTOR, Implicit, Socket
from engine.state.shaders import MODE_CLOSURES, MODE_TRANSPARENCY

_COMPONENTS = {"Reflection": 0, "Transmission": 1}
_COLORS = {"ABSORPTION": FIBRE_ABSORPTION, "MELANIN": FIBRE_MELANIN, "COLOR": FIBRE_COLOR}
_MODELS = {"CHIANG": 0, "HUANG": 1}
_NUMBERS = {
    "Melanin": 0.8,
    "Melanin Redness": 1.0,
    "Random Color": 0.0,
    "Roughness": 0.3,
    "Radial Roughness": 0.3,
    "Random Roughness": 0.0,
    "Coat": 0.0,
    "Offset": 0.0349066,
    "IOR": 1.55,
    "Aspect Ratio": 0.85,
    "R lobe": 1.0,
    "TT lobe": 1.0,
    "TRT lobe": 1.0,
}

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
        builder.input(Socket("\0edge", VECTOR, Implicit.EDGE_V)),
    )
    component = choice(node, builder, "component", _COMPONENTS, "Reflection")
    builder.closure(ops.opcode("HAIR"), weight, operands, (component,), modes=(MODE_CLOSURES,))


def principled_hair(node: Node, weight: Value, builder: Any) -> None:
    """Principled Hair BSDF."""
    mode = choice(node, builder, "parametrization", _COLORS, "COLOR")
    color = Socket("Color", COLOR, (0.017513, 0.005763, 0.002059))
    if mode == FIBRE_ABSORPTION:
        color = Socket("Absorption Coefficient", VECTOR, (0.245531, 0.52, 1.365))
    colors = (builder.input(color), builder.input(Socket("Tint", COLOR, (1.0, 1.0, 1.0))))
    # Its own value does not count, as in Cycles.
    is_linked = isinstance(node.inputs.get("Random"), Link)
    random = builder.input(Socket("Random" if is_linked else "\0random", FLOAT, Implicit.CURVE_RANDOM))
    if choice(node, builder, "model", _MODELS, "CHIANG") == _MODELS["HUANG"]:
        _huang(node, weight, builder, (colors, random, mode))
        return
    names = (
        "Melanin", "Melanin Redness", "Random Color", "Roughness", "Radial Roughness", "Random Roughness", "Coat",
        "Offset", "IOR",
    )  # fmt: skip
    operands = (*colors, *_numbers(builder, names), random, _edge(builder))
    builder.closure(ops.opcode("CHIANG"), weight, operands, (mode,), modes=(MODE_CLOSURES,))


def _numbers(builder: Any, names: tuple[str, ...]) -> tuple[Value, ...]:
    return tuple(builder.input(Socket(name, FLOAT, _NUMBERS[name])) for name in names)


def _edge(builder: Any) -> Value:
    """The tangent on surfaces that are no strands."""
    return builder.input(Socket("\0edge", VECTOR, Implicit.EDGE_U))


def _huang(node: Node, weight: Value, builder: Any, common: tuple[tuple[Value, ...], Value, int]) -> None:
    """Huang's model; `common` are what it has in common with Chiang's: colours, random number, FIBRE_*."""
    colors, random, mode = common
    (aspect,) = _numbers(builder, ("Aspect Ratio",))
    normal: Value = Constant((0.0, 0.0, 0.0))
    is_round = isinstance(aspect, Constant) and aspect.value == (1.0,)
    if not is_round:
        normal = builder.input(Socket("\0normal", VECTOR, Implicit.CURVE_NORMAL))
        builder.closure(ops.opcode("HUANG_OUTSIDE"), weight, (aspect, normal), modes=(MODE_TRANSPARENCY,))
    names = ("Melanin", "Melanin Redness", "Random Color", "Roughness", "Random Roughness", "Offset", "IOR")
    thickness = builder.input(Socket("\0thickness", FLOAT, Implicit.CURVE_THICKNESS))
    lobes = _numbers(builder, ("R lobe", "TT lobe", "TRT lobe"))
    operands = (*colors, *_numbers(builder, names), random, aspect, *lobes, thickness, normal, _edge(builder))
    builder.closure(ops.opcode("HUANG"), weight, operands, (mode,), modes=(MODE_CLOSURES,))
