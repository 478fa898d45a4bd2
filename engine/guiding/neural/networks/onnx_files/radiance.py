# SPDX-License-Identifier: GPL-3.0-or-later
"""The radiance network as an ONNX graph, all of it: encodings, layers and the output's transform.

A vertex may have several candidate directions, and the graph asks each vertex once: `position` (and `u`) have a row a
vertex, `direction` a row a candidate, and `vertex` says which row of the former each of the latter belongs to.
"""

from __future__ import annotations

import math

import numpy as np

from engine.guiding.neural.networks.grids import grid_levels
from engine.guiding.neural.networks.onnx_files import encodings
from engine.guiding.neural.networks.onnx_files.graph import GraphBuilder
from engine.guiding.neural.networks.onnx_files.messages import INT64, Graph
from engine.guiding.neural.networks.onnx_files.parameters import add_parameters
from engine.guiding.neural.networks.radiance import LOG_RADIANCE_LIMIT, NetworkShape, Snapshot

_DOC = """\
Incident radiance. position: float32 (V, 3), world [m]. u: float32 (V,), in [0, 1], if the network knows it: time of the
shutter, or how far within a quarter of the wavelengths. direction: float32 (N, 3), unit, world, away from the position.
vertex: int64 (N,), row of position that a direction belongs to. radiance: float32 (N, channels), finite and above 0; of
a network by quarter, channel q belongs to the wavelengths' q-th quarter."""


def radiance_graph(shape: NetworkShape, snapshot: Snapshot) -> Graph:
    """A snapshot as a graph that gives what `radiance_query.predict_network` gives; by quarter, the quarters in order.

    Raises
    ------
    ValueError
        If the snapshot is not valid for `shape` (`Snapshot.validate`).
    """
    snapshot.validate(shape)
    graph = GraphBuilder()
    position = graph.input("position", ("V", 3))
    direction = graph.input("direction", ("N", 3))
    vertex = graph.input("vertex", ("N",), INT64)
    names = add_parameters(graph, shape, snapshot.parameters)
    place = encodings.contract(graph, position, snapshot.bounds)
    level = grid_levels(shape.resolutions, shape.level_offsets, shape.table_size)
    features = encodings.grids(graph, [place], level, names["table"][0], shape.level_features)
    latent = graph.add("MatMul", features, names["position_weights"][0])
    if shape.u_width:
        u = encodings.unit(graph, graph.input("u", ("V",)))
        parts = []
        if shape.plane_levels:
            level = grid_levels(shape.plane_resolutions, shape.plane_offsets)
            parts.append(encodings.planes(graph, place, u, level, names["planes"][0], shape.plane_features))
        if shape.u_frequencies:
            parts.append(encodings.frequencies(graph, u, shape.u_frequencies))
        features = parts[0] if len(parts) == 1 else graph.add("Concat", *parts, axis=1)
        latent = graph.add("Add", latent, graph.add("MatMul", features, names["u_weights"][0]))
    features = encodings.blobs(graph, direction, 3, shape.direction_bins)
    first = graph.add("MatMul", features, names["direction_weights"][0])
    first = graph.add("Relu", graph.add("Add", first, graph.add("Gather", latent, vertex, axis=0)))
    value = encodings.layers(graph, first, [*names["hidden_weights"], *names["output_weights"]])
    value = graph.clip(value, -LOG_RADIANCE_LIMIT, LOG_RADIANCE_LIMIT, if_nan=-LOG_RADIANCE_LIMIT)
    value = graph.add("Exp", graph.add("Add", value, graph.floats(np.float32(math.log(snapshot.scale)))))
    graph.output("radiance", value, ("N", shape.channel_count))
    return graph.graph("radiance", _DOC)
