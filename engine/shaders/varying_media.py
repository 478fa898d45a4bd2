# SPDX-License-Identifier: GPL-3.0-or-later
"""What is linked to a volume output, as a program that says at each point what the medium is there.

`engine.shaders.media` folds what is the same everywhere into numbers, by the formulas that the instructions have.
"""

from __future__ import annotations

import math
from collections.abc import Callable

from engine.kernels.shader import ops_closure, ops_math
from engine.kernels.shader import ops_volume as ops
from engine.scene.description import Link
from engine.shaders import nodes_closure
from engine.shaders.arithmetic import ONE, ZERO
from engine.shaders.media import (
    LEFT_OUT,
    NODES,
    attributes_of,
    black_body,
    fournier_forand_parameters,
    mie_parameters,
    phase_of,
)
from engine.shaders.node_values import NodeBuilder, NodeValues
from engine.shaders.nodes_input import grid
from engine.shaders.nodes_texture_math import COMPONENT_OPERATIONS, MATH_OPERATIONS
from engine.shaders.program import Constant, Instruction, Value, is_zero
from engine.shaders.table import COLOR, FLOAT, VECTOR, Socket

_BLACK = Constant((0.0, 0.0, 0.0))


class _MediumBuilder(NodeBuilder):
    """What the entries below see of one node, of this weight."""

    def __init__(self, values: NodeValues, index: int, weight: Value, roots: list[int]) -> None:
        super().__init__(values, index)
        self.values = values
        self.weight = weight
        self._roots = roots

    def number(self, identifier: str, default: float) -> Value:
        """Value of a socket that is a number."""
        return self.input(Socket(identifier, FLOAT, default))

    def color(self, identifier: str, default: float) -> Value:
        """Value of a socket that is a colour."""
        return self.input(Socket(identifier, COLOR, (default,) * 3))

    def vector(self, identifier: str, default: float) -> Value:
        """Value of a socket that is a vector."""
        return self.input(Socket(identifier, VECTOR, (default,) * 3))

    def add(self, opcode: int, *operands: Value, weight: Value | None = None) -> None:
        """Append an instruction with the node's weight, or another."""
        instruction = Instruction(opcode, (self.weight if weight is None else weight, *operands), ())
        self._roots.append(self.values.arithmetic.code.append_effect(instruction))

    def times_grid(self, value: Value, name: str) -> Value:
        """A number or colour times what the volume's grid of this name holds; without it the value alone."""
        if not name or not self.has_grid(name):
            return value
        outputs = (Socket("", COLOR), Socket("\0fac", FLOAT), Socket("\0alpha", FLOAT))
        color, mean, _alpha = self.values.emit(grid(self, name, outputs, default=1.0), self)
        if value.width == 1:
            return self.values.arithmetic.multiply(value, mean)
        multiply = MATH_OPERATIONS.index(COMPONENT_OPERATIONS["MULTIPLY"])
        instruction = Instruction(ops_math.OP_VECTOR_COMPONENTS, (value, color, _BLACK), (3, 1), (multiply,))
        return self.append(instruction, is_varying=True)[0]

    def _number_everywhere(self, identifier: str, otherwise: float) -> float:
        """Value of a socket that may not vary; one that does is reported, and replaced."""
        value = self.constant_input(Socket(identifier, FLOAT, otherwise))
        if value is not None and math.isfinite(value[0]):
            return value[0]
        if value is None:
            self.notice(f"its {identifier} varies, which is not supported", f"{otherwise:g}")
        else:
            self.notice(f"its {identifier} is NaN or infinite", f"{otherwise:g}")
        return otherwise

    def phases(self) -> list[tuple[Value, tuple[Value, Value, Value]]]:
        """Phase functions that the node is set to: their shares, and mean cosine, alpha and delta of each."""
        phase = phase_of(self)
        if phase == "RAYLEIGH":
            return [(ONE, (ZERO, ONE, ZERO))]
        if phase == "DRAINE":
            return [(ONE, (self.number("Anisotropy", 0.0), self.number("Alpha", 0.5), ZERO))]
        if phase == "HENYEY_GREENSTEIN":
            return [(ONE, (self.number("Anisotropy", 0.0), ZERO, ZERO))]
        if phase == "FOURNIER_FORAND":
            ior, backscatter = self._number_everywhere("IOR", 1.33), self._number_everywhere("Backscatter", 0.1)
            mean_cosine, exponent, delta = fournier_forand_parameters(ior, backscatter)
            return [(ONE, (Constant((mean_cosine,)), Constant((exponent,)), Constant((delta,))))]
        g, draine_g, alpha, share = mie_parameters(self._number_everywhere("Diameter", 20.0))
        return [
            (Constant((1.0 - share,)), (Constant((g,)), ZERO, ZERO)),
            (Constant((share,)), (Constant((draine_g,)), Constant((alpha,)), ZERO)),
        ]


def _absorption(builder: _MediumBuilder) -> None:
    builder.add(ops.OP_ABSORPTION, builder.color("Color", 0.8), builder.number("Density", 1.0))


def _scatter(builder: _MediumBuilder) -> None:
    color, density = builder.color("Color", 0.8), builder.number("Density", 1.0)
    for share, phase in builder.phases():
        weight = builder.values.arithmetic.multiply(builder.weight, share)
        builder.add(ops.OP_SCATTER, color, density, *phase, weight=weight)


def _coefficients(builder: _MediumBuilder) -> None:
    scattering = builder.vector("Scatter Coefficients", 1.0)
    absorption = builder.vector("Absorption Coefficients", 1.0)
    builder.add(ops.OP_COEFFICIENTS, absorption, _BLACK, builder.vector("Emission Coefficients", 0.0), ZERO, ZERO, ZERO)
    for share, phase in builder.phases():
        weight = builder.values.arithmetic.multiply(builder.weight, share)
        builder.add(ops.OP_COEFFICIENTS, _BLACK, scattering, _BLACK, *phase, weight=weight)


def _principled(builder: _MediumBuilder) -> None:
    density_name, color_name, temperature_name = attributes_of(builder.node)
    share = builder.number("Blackbody Intensity", 0.0)
    temperature = builder.times_grid(builder.number("Temperature", 1000.0), temperature_name)
    hot = _BLACK if is_zero(share) else black_body(builder.values, temperature)
    builder.add(
        ops.OP_PRINCIPLED, builder.times_grid(builder.color("Color", 0.5), color_name),
        builder.times_grid(builder.number("Density", 1.0), density_name),
        builder.color("Absorption Color", 0.0), builder.number("Anisotropy", 0.0),
        builder.number("Emission Strength", 0.0), builder.color("Emission Color", 1.0), share,
        builder.color("Blackbody Tint", 1.0), temperature, hot,
    )


def _emission(builder: _MediumBuilder) -> None:
    builder.add(ops_closure.OP_EMISSION, builder.color("Color", 1.0), builder.number("Strength", 1.0))


_LOWERINGS: dict[str, Callable[[_MediumBuilder], None]] = {
    "ShaderNodeVolumeAbsorption": _absorption,
    "ShaderNodeVolumeScatter": _scatter,
    "ShaderNodeVolumeCoefficients": _coefficients,
    "ShaderNodeVolumePrincipled": _principled,
    "ShaderNodeEmission": _emission,
}


def lower_medium(values: NodeValues, volume: Link) -> list[int]:
    """Append the instructions of a medium that varies to the code of `values`.

    Parameters
    ----------
    values : NodeValues
        Values of the graph, made for this alone.
    volume : Link
        What is linked to the output.

    Returns
    -------
    list of int
        Those to be run in MODE_MEDIUM, by index; empty: there is nothing that could be rendered.
    """
    roots: list[int] = []
    _lower(values, volume, ONE, roots, frozenset())
    return roots


def _lower(values: NodeValues, link: Link, weight: Value, roots: list[int], above: frozenset[int]) -> None:
    """Append the media of what is linked, `weight` times; `above` are the nodes that lead there."""
    if not values.exists(link, "the volume output") or is_zero(weight):
        return
    builder = _MediumBuilder(values, link.node, weight, roots)
    node = builder.node
    if link.node in above:
        builder.notice("is part of a loop of links", "the loop is cut open there")
    elif node.kind in nodes_closure.MIXES:
        shares = (weight, weight)
        if node.kind == nodes_closure.MIX_SHADER:
            shares = values.arithmetic.mix_weights(weight, builder.number("Fac", 0.5))
        for name, share in zip(("Shader", "Shader_001"), shares, strict=True):
            below = node.inputs.get(name)
            if isinstance(below, Link):
                _lower(values, below, share, roots, above | {link.node})
    elif node.kind in _LOWERINGS:
        values.notice_unknown(node, NODES[node.kind].inputs, NODES[node.kind].settings)
        _LOWERINGS[node.kind](builder)
    else:
        builder.notice(f"{node.kind} is not supported in a volume", LEFT_OUT)
