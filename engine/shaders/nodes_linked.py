# SPDX-License-Identifier: GPL-3.0-or-later
"""Shader nodes whose lobes are linked (`engine/kernels/bsdf/linked.py`), see `nodes_closure`."""

from __future__ import annotations

from typing import Any

from engine.kernels.bsdf.kinds import GGX
from engine.kernels.bsdf.linked_lobes import ADDED, link_lobes
from engine.kernels.shader import ops_closure as ops
from engine.scene.description import Node
from engine.shaders.closure_inputs import BLACK, ONE, ZERO, color, normal, number
from engine.shaders.options import choice
from engine.shaders.program import Value, is_zero
from engine.shaders.table import VECTOR, Implicit, Socket
from engine.state.shaders import MODE_CLOSURES


def film(builder: Any) -> tuple[Value, Value]:
    """Thickness and refractive index of a thin film."""
    thickness = number(builder, "Thin Film Thickness", 0.0)
    if is_zero(thickness):
        return ZERO, ONE
    link_lobes()
    return thickness, number(builder, "Thin Film IOR", 1.33)


def metal(
    builder: Any, weight: Value, distribution: int, tangent: Value, numbers: tuple[Value, ...], *, by_index: bool
) -> None:
    """The lobe of the Metallic BSDF; `numbers` are roughness, anisotropy, rotation, film thickness and film IOR."""
    link_lobes()
    if by_index:
        colors = _index(builder, "IOR", (2.757, 2.513, 2.231)), _index(builder, "Extinction", (3.867, 3.404, 3.009))
    else:
        colors = color(builder, "Base Color", 0.617), color(builder, "Edge Tint", 0.695)
    immediates = (ADDED["METAL_BY_INDEX" if by_index else "METAL"], distribution)
    operands = (normal(builder), *colors, tangent, *numbers)
    builder.closure(ops.opcode("LINKED"), weight, operands, immediates, modes=(MODE_CLOSURES,))


def glass(
    builder: Any, weight: Value, distribution: int, inside: tuple[Value, Value],
    facets: tuple[Value, Value, tuple[Value, Value]],
) -> None:  # fmt: skip
    """The lobe of an anisotropic Glass BSDF: colour and refractive index, roughness, anisotropy and film."""
    link_lobes()
    roughness, anisotropy, film_values = facets
    tangent = builder.input(Socket("Tangent", VECTOR, Implicit.TANGENT))
    numbers = (roughness, anisotropy, number(builder, "Rotation", 0.0), *film_values)
    operands = (normal(builder), *inside, tangent, *numbers)
    builder.closure(ops.opcode("LINKED"), weight, operands, (ADDED["GLASS"], distribution), modes=(MODE_CLOSURES,))


def _index(builder: Any, identifier: str, default: tuple[float, float, float]) -> Value:
    return builder.input(Socket(identifier, VECTOR, default))


def _lobe(builder: Any, name: str, weight: Value, *numbers: Value) -> None:
    """A lobe of a colour and up to five numbers."""
    link_lobes()
    numbers = (*numbers, *[ZERO] * (5 - len(numbers)))
    operands = (normal(builder), color(builder), BLACK, BLACK, *numbers)
    builder.closure(ops.opcode("LINKED"), weight, operands, (ADDED[name], GGX), modes=(MODE_CLOSURES,))


def toon(node: Node, weight: Value, builder: Any) -> None:
    """Toon BSDF."""
    name = ("TOON_DIFFUSE", "TOON_GLOSSY")[choice(node, builder, "component", ("DIFFUSE", "GLOSSY"), "DIFFUSE")]
    _lobe(builder, name, weight, number(builder, "Size", 0.5), number(builder, "Smooth", 0.0))


def velvet(node: Node, weight: Value, builder: Any) -> None:
    """Velvet BSDF of Blender 3, Ashikhmin's sheen since."""
    _lobe(builder, "VELVET", weight, number(builder, "Sigma" if "Sigma" in node.inputs else "Roughness", 1.0))


def ray_portal(node: Node, weight: Value, builder: Any) -> None:
    """Ray Portal BSDF. Shadow rays meet it as something opaque, so that it is in no other mode."""
    link_lobes()
    position = builder.input(Socket("Position", VECTOR, Implicit.POSITION))
    direction = builder.input(Socket("Direction", VECTOR, (0.0, 0.0, 0.0)))
    operands = (normal(builder), color(builder, default=1.0), position, direction, *[ZERO] * 5)
    builder.closure(ops.opcode("LINKED"), weight, operands, (ADDED["PORTAL"], GGX), modes=(MODE_CLOSURES,))
