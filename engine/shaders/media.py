# SPDX-License-Identifier: GPL-3.0-or-later
"""What is linked to a volume output, folded into the coefficients of a medium that is the same everywhere.

`engine.shaders.varying_media` makes a program of a medium that varies.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from engine.kernels.shader import ops_math
from engine.scene.description import Link, Node
from engine.shaders import nodes_closure
from engine.shaders.medium import BLACK, Medium, PhaseLobe, Triple
from engine.shaders.node_values import NodeBuilder, NodeValues
from engine.shaders.options import choice
from engine.shaders.program import Constant, Instruction, Value
from engine.shaders.table import COLOR, FLOAT, VECTOR, Socket, SocketType

LEFT_OUT = "no volume"
_PHASES = ("HENYEY_GREENSTEIN", "FOURNIER_FORAND", "DRAINE", "RAYLEIGH", "MIE")
#: Stefan and Boltzmann's constant over pi, in the unit of emission that Cycles has here.
_STEFAN_BOLTZMANN = 5.670373e-8 * 1e-6 / math.pi
#: Mean cosines are kept off -1 and 1 by this much, as in Cycles.
_LEAST_SPREAD = 1e-3
#: Shares of light that goes back below which all of it might as well go straight on.
_LEAST_BACKSCATTER = 1e-6


class VaryingError(Exception):
    """An input is not a constant: the medium may vary in space."""


class _NodeReader:
    """Constant inputs of one node."""

    def __init__(self, values: NodeValues, index: int) -> None:
        self.values = values
        self.builder = NodeBuilder(values, index)
        self.node: Node = self.builder.node

    def _constant(self, identifier: str, type_: SocketType, default: float) -> tuple[float, ...]:
        value = self.builder.constant_input(Socket(identifier, type_, default if type_ is FLOAT else (default,) * 3))
        if value is None:
            raise VaryingError
        if not all(math.isfinite(number) for number in value):
            self.builder.notice(f"its {identifier} is NaN or infinite", "0")
            return (0.0,) * len(value)
        return value

    def number(self, identifier: str, default: float) -> float:
        return self._constant(identifier, FLOAT, default)[0]

    def color(self, identifier: str, default: float) -> Triple:
        red, green, blue = self._constant(identifier, COLOR, default)
        return red, green, blue

    def vector(self, identifier: str, default: float) -> Triple:
        red, green, blue = self._constant(identifier, VECTOR, default)
        return red, green, blue

    def black_body(self, temperature: float) -> Triple:
        """Colour of a black body in the working space."""
        color = black_body(self.values, Constant((temperature,)))
        assert isinstance(color, Constant)
        red, green, blue = color.value
        return red, green, blue


def black_body(values: NodeValues, temperature: Value) -> Value:
    """Colour of a black body of a temperature [K], in the working space."""
    (color,) = values.arithmetic.append(Instruction(ops_math.OP_BLACKBODY, (temperature,), (3,)), is_varying=False)
    return values.in_working_space(color)


def _scaled(color: Triple, factor: float) -> Triple:
    """A colour times a number, no channel below 0."""
    red, green, blue = (max(channel * factor, 0.0) for channel in color)
    return red, green, blue


def _kept_g(g: float) -> float:
    return math.copysign(min(abs(g), 1.0 - _LEAST_SPREAD), g)


def phase_of(builder: NodeBuilder) -> str:
    """The phase function that a node is set to."""
    return _PHASES[choice(builder.node, builder, "phase", _PHASES, "HENYEY_GREENSTEIN")]


def _lobes(reader: _NodeReader, scattering: Triple) -> tuple[PhaseLobe, ...]:
    """What a node scatters, by the phase function that it is set to."""
    if not any(scattering):
        return ()
    phase = phase_of(reader.builder)
    if phase == "RAYLEIGH":
        return (PhaseLobe(scattering, 0.0, 1.0),)
    if phase == "DRAINE":
        g, alpha = reader.number("Anisotropy", 0.0), reader.number("Alpha", 0.5)
        return (PhaseLobe(scattering, _kept_g(g), min(max(alpha, 0.0), 1e4)),)
    if phase == "FOURNIER_FORAND":
        ior, backscatter = reader.number("IOR", 1.33), reader.number("Backscatter", 0.1)
        return (PhaseLobe(scattering, *fournier_forand_parameters(ior, backscatter)),)
    if phase == "MIE":
        g, draine_g, alpha, share = mie_parameters(reader.number("Diameter", 20.0))
        return (
            PhaseLobe(_scaled(scattering, 1.0 - share), _kept_g(g)),
            PhaseLobe(_scaled(scattering, share), _kept_g(draine_g), alpha),
        )
    return (PhaseLobe(scattering, _kept_g(reader.number("Anisotropy", 0.0))),)


def fournier_forand_parameters(ior: float, backscatter: float) -> tuple[float, float, float]:
    """Particles in water, as `engine.kernels.bsdf.fournier_forand` takes them.

    Parameters
    ----------
    ior : float
        Refractive index of the particles over that of water.
    backscatter : float
        Share of the light that goes back.

    Returns
    -------
    mean_cosine, exponent, delta : float

    References
    ----------
    Fournier and Jonasz 1999, "Computer-based underwater imaging analysis", Eqs. (2) and (6).
    """
    # Kept off a mirror, where all goes straight on, and off light that is the same all around, as in Cycles.
    share = min(max(abs(backscatter), _LEAST_BACKSCATTER), 0.5 - _LEAST_SPREAD)
    delta = 4.0 / (3.0 * max(ior - 1.0, _LEAST_SPREAD) ** 2)
    sideways = 0.5 * delta
    if abs(sideways - 1.0) < 1e-6:
        sideways = 1.0 + 1e-6
        delta = 2.0 * sideways
    exponent = math.log1p(2.0 * share * (sideways - 1.0)) / math.log(sideways)
    # The mean of s is 1 less the integral of F, to which what is added for large angles brings nothing. F is smooth in
    # the fourth root of s.
    nodes, weights = np.polynomial.legendre.leggauss(64)
    root = 0.5 * (nodes + 1.0)
    s = root**4
    x = delta * s
    with np.errstate(divide="ignore", invalid="ignore"):
        less = np.where(x == 1.0, 1.0 - exponent * (1.0 - s), (x**exponent * (1.0 - s) + s - x) / (1.0 - x))
    mean = 1.0 - float((0.5 * weights * less * 4.0 * root**3).sum())
    return 1.0 - 2.0 * mean, exponent, delta


def mie_parameters(diameter: float) -> tuple[float, float, float, float]:
    """Water droplets as a mixture of two phase functions.

    Parameters
    ----------
    diameter : float [um]

    Returns
    -------
    g : float, of Henyey and Greenstein's function
    draine_g, alpha : float, of Draine's
    share : float in [0, 1], of Draine's

    References
    ----------
    Jendersie and d'Eon 2023, "An Approximate Mie Scattering Function for Fog and Cloud Rendering", supplemental,
    Eqs. (7) to (22).
    """
    d = max(diameter, 0.0)
    if d <= 0.1:
        return 13.8 * d * d, 1.1456 * d * math.sin(9.29044 * d), 250.0, 0.252977 - 312.983 * d**4.3
    log_d = math.log(d)
    if d < 1.5:
        a = (log_d - 0.238604) * (log_d + 1.00667)
        b = 0.507522 - 0.15677 * log_d
        c = 1.19692 * math.cos(a / b) + 1.37932 * log_d + 0.0625835
        share = 0.146209 * math.cos(3.38707 * log_d + 2.11193) + 0.316072 + 0.0778917 * log_d
        return 0.862 - 0.143 * log_d * log_d, 0.379685 * math.cos(c) + 0.344213, 250.0, share
    if d < 5.0:
        wave = math.cos(5.68947 * (math.log(log_d) - 0.0292149))
        draine_g = 0.500411 - 0.081287 / (-2.0 * log_d + math.tan(log_d) + 1.27551)
        return (
            0.0604931 * math.log(log_d) + 0.940256, draine_g, 7.30354 * log_d + 6.31675,
            0.026914 * (log_d - wave) + 0.3764,
        )  # fmt: skip
    return (
        math.exp(-0.0990567 / (d - 1.67154)),
        math.exp(-2.20679 / (d + 3.91029) - 0.428934),
        math.exp(3.62489 - 8.29288 / (d + 5.52825)),
        math.exp(-0.599085 / (d - 0.641583) - 0.665888),
    )


def _absorption(reader: _NodeReader, weight: float) -> Medium:
    density = weight * max(reader.number("Density", 1.0), 0.0)
    red, green, blue = reader.color("Color", 0.8)
    return Medium(absorption=_scaled((1.0 - red, 1.0 - green, 1.0 - blue), density))


def _scatter(reader: _NodeReader, weight: float) -> Medium:
    density = weight * max(reader.number("Density", 1.0), 0.0)
    return Medium(lobes=_lobes(reader, _scaled(reader.color("Color", 0.8), density)))


def _coefficients(reader: _NodeReader, weight: float) -> Medium:
    return Medium(
        absorption=_scaled(reader.vector("Absorption Coefficients", 1.0), weight),
        emission=_scaled(reader.vector("Emission Coefficients", 0.0), weight),
        lobes=_lobes(reader, _scaled(reader.vector("Scatter Coefficients", 1.0), weight)),
    )


def attributes_of(node: Node) -> tuple[str, str, str]:
    """Names of a Principled Volume's attributes of density, colour and temperature; '' = none."""
    defaults = {"Density Attribute": "density", "Color Attribute": "", "Temperature Attribute": "temperature"}
    density, color, temperature = (str(node.inputs.get(name, default)) for name, default in defaults.items())
    return density, color, temperature


def _principled(reader: _NodeReader, weight: float) -> Medium:
    """Without grids of the attributes' names the node's numbers stand alone, as in Cycles."""
    if any(reader.builder.has_grid(name) for name in attributes_of(reader.node)):
        raise VaryingError
    density = weight * max(reader.number("Density", 1.0), 0.0)
    absorption = BLACK
    lobes: tuple[PhaseLobe, ...] = ()
    if density > 0.0:
        color = reader.color("Color", 0.5)
        clear = (math.sqrt(max(channel, 0.0)) for channel in reader.color("Absorption Color", 0.0))
        red, green, blue = (max(1.0 - a, 0.0) * max(1.0 - b, 0.0) for a, b in zip(color, clear, strict=True))
        absorption = _scaled((red, green, blue), density)
        scattering = _scaled(color, density)
        if any(scattering):
            lobes = (PhaseLobe(scattering, _kept_g(reader.number("Anisotropy", 0.0))),)
    emission = BLACK
    strength = reader.number("Emission Strength", 0.0)
    if strength > 0.0:
        emission = _scaled(reader.color("Emission Color", 1.0), strength * weight)
    share = reader.number("Blackbody Intensity", 0.0)
    if share > 0.0:
        temperature = max(reader.number("Temperature", 1000.0), 0.0)
        intensity = _STEFAN_BOLTZMANN * (1.0 + share * (temperature**4 - 1.0)) * weight
        tint, hot = reader.color("Blackbody Tint", 1.0), reader.black_body(temperature)
        red, green, blue = (e + t * h * intensity for e, t, h in zip(emission, tint, hot, strict=True))
        emission = _scaled((red, green, blue), 1.0)
    return Medium(absorption, emission, lobes)


def _emission(reader: _NodeReader, weight: float) -> Medium:
    return Medium(emission=_scaled(reader.color("Color", 1.0), reader.number("Strength", 1.0) * weight))


_SCATTER_INPUTS = ("Anisotropy", "IOR", "Backscatter", "Alpha", "Diameter")


@dataclass(frozen=True)
class VolumeNode:
    """A node of volumes: how it is folded, and all that is known of it."""

    fold: Callable[[_NodeReader, float], Medium]
    inputs: tuple[str, ...]
    settings: tuple[str, ...] = ()


NODES: dict[str, VolumeNode] = {
    "ShaderNodeVolumeAbsorption": VolumeNode(_absorption, ("Color", "Density")),
    "ShaderNodeVolumeScatter": VolumeNode(_scatter, ("Color", "Density", *_SCATTER_INPUTS), ("phase",)),
    "ShaderNodeVolumeCoefficients": VolumeNode(
        _coefficients,
        ("Absorption Coefficients", "Scatter Coefficients", "Emission Coefficients", *_SCATTER_INPUTS), ("phase",),
    ),
    "ShaderNodeVolumePrincipled": VolumeNode(
        _principled,
        (
            *("Color", "Color Attribute", "Density", "Density Attribute", "Anisotropy", "Absorption Color"),
            *("Emission Strength", "Emission Color", "Blackbody Intensity", "Blackbody Tint", "Temperature"),
            "Temperature Attribute",
        ),
    ),
    "ShaderNodeEmission": VolumeNode(_emission, ("Color", "Strength")),
}  # fmt: skip


def is_shader(kind: str) -> bool:
    """Whether nodes of this kind are known as shaders, of surfaces or volumes."""
    return kind in nodes_closure.CLOSURES or kind in nodes_closure.MIXES or kind in NODES


def fold_medium(values: NodeValues, volume: Link) -> Medium | None:
    """The medium of a graph.

    Parameters
    ----------
    values : NodeValues
        Values of the graph, made for this alone: what is asked for becomes no part of a program.
    volume : Link
        What is linked to the output.

    Returns
    -------
    Medium or None
        None: there is nothing of it that could be rendered.

    Raises
    ------
    VaryingError
    """
    found: list[Medium] = []
    _fold(values, volume, 1.0, found, frozenset())

    def total(parts: list[Triple]) -> Triple:
        red, green, blue = (sum(channel) for channel in zip(*parts, strict=True))
        return red, green, blue

    if not found:
        return None
    medium = Medium(
        total([part.absorption for part in found]), total([part.emission for part in found]),
        tuple(lobe for part in found for lobe in part.lobes),
    )
    return None if medium.is_empty else medium


def _fold(values: NodeValues, link: Link, weight: float, found: list[Medium], above: frozenset[int]) -> None:
    """Append the media of what is linked, `weight` times; `above` are the nodes that lead there."""
    if not values.exists(link, "the volume output") or weight == 0.0:
        return
    reader = _NodeReader(values, link.node)
    node = reader.node
    if link.node in above:
        reader.builder.notice("is part of a loop of links", "the loop is cut open there")
        return
    if node.kind in nodes_closure.MIXES:
        shares = (weight, weight)
        if node.kind == nodes_closure.MIX_SHADER:
            factor = min(max(reader.number("Fac", 0.5), 0.0), 1.0)
            shares = (weight * (1.0 - factor), weight * factor)
        for name, share in zip(("Shader", "Shader_001"), shares, strict=True):
            below = node.inputs.get(name)
            if isinstance(below, Link):
                _fold(values, below, share, found, above | {link.node})
    elif node.kind in NODES:
        known = NODES[node.kind]
        values.notice_unknown(node, known.inputs, known.settings)
        found.append(known.fold(reader, weight))
    else:
        reader.builder.notice(f"{node.kind} is not supported in a volume", LEFT_OUT)
