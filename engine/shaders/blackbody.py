# SPDX-License-Identifier: GPL-3.0-or-later
"""Which node graphs emit as a black body does, so that renders with wavelengths can use Planck's law itself."""

from __future__ import annotations

import math

from engine.scene.description import Link, Node, NodeGraph

_EMITTERS = ("ShaderNodeEmission", "ShaderNodeBackground")
#: Default of the node [K].
_DEFAULT_TEMPERATURE = 6500.0


def _linked(graph: NodeGraph, link: object) -> Node | None:
    """The node that a link comes from; None if there is none."""
    return graph.nodes[link.node] if isinstance(link, Link) and 0 <= link.node < len(graph.nodes) else None


def emission_temperature(graph: NodeGraph | None) -> float:
    """Temperature of a graph that is an emission whose colour is a black body of one temperature.

    Returns
    -------
    float [K]
        0 for all other graphs: their emission has the smooth spectrum of its colour.
    """
    if graph is None:
        return 0.0
    emitter = _linked(graph, graph.surface)
    if emitter is None or emitter.kind not in _EMITTERS:
        return 0.0
    source = _linked(graph, emitter.inputs.get("Color"))
    if source is None or source.kind != "ShaderNodeBlackbody":
        return 0.0
    temperature = source.inputs.get("Temperature", _DEFAULT_TEMPERATURE)
    is_number = isinstance(temperature, (int, float)) and math.isfinite(temperature)
    return max(float(temperature), 0.0) if is_number else 0.0
