# SPDX-License-Identifier: GPL-3.0-or-later
"""Which node graphs emit as a black body does, so that renders with wavelengths can use Planck's law itself."""

from __future__ import annotations

from engine.scene.description import Link, NodeGraph

_EMITTERS = ("ShaderNodeEmission", "ShaderNodeBackground")
#: Of the node [K].
_DEFAULT_TEMPERATURE = 6500.0


def emission_temperature(graph: NodeGraph | None) -> float:
    """Temperature of a graph that is an emission whose colour is a black body of one temperature.

    Returns
    -------
    float [K]
        0 for all other graphs: their emission has the smooth spectrum of its colour.
    """
    if graph is None or graph.surface is None:
        return 0.0
    emitter = graph.nodes[graph.surface.node]
    color = emitter.inputs.get("Color")
    if emitter.kind not in _EMITTERS or not isinstance(color, Link):
        return 0.0
    source = graph.nodes[color.node]
    temperature = source.inputs.get("Temperature", _DEFAULT_TEMPERATURE)
    if source.kind != "ShaderNodeBlackbody" or isinstance(temperature, Link):
        return 0.0
    return float(temperature)
