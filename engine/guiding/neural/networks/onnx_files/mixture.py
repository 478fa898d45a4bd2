# SPDX-License-Identifier: GPL-3.0-or-later
"""A mixture network as an ONNX graph: points in, raw parameters of mixtures out, as `mixture.inference` has them."""

from __future__ import annotations

from engine.guiding.neural.networks.grids import grid_levels
from engine.guiding.neural.networks.mixture.inference import RAW_LIMIT
from engine.guiding.neural.networks.mixture.shape import MixtureShape
from engine.guiding.neural.networks.onnx_files import encodings
from engine.guiding.neural.networks.onnx_files.graph import GraphBuilder
from engine.guiding.neural.networks.onnx_files.messages import Graph
from engine.guiding.neural.networks.onnx_files.parameters import add_parameters
from engine.guiding.neural.networks.radiance import Snapshot

_DOC = """\
Raw parameters of a mixture of lobes on the sphere of directions. position: float32 (N, 3), world [m]. As far as the
network knows them: normal: float32 (N, 3), unit, on the viewer's side; wo: float32 (N, 3), unit, towards the viewer;
roughness: float32 (N,), in [0, 1]; u: float32 (N,), in [0, 1]. raw: float32 (N, outputs), for each lobe what its model
asks for, as NeuralGuide's engine/guiding/neural/networks/lobes says, and the logit of the guide's share last where
there is one."""


def _direction(graph: GraphBuilder, name: str, encoding: str, size: int) -> str:
    """Features of an input of unit vectors: `features._write_direction`."""
    vector = graph.clip(graph.input(name, ("N", 3)), -1.0, 1.0, if_nan=0.0)
    if encoding == "BLOB":
        return encodings.blobs(graph, vector, 3, size)
    return encodings.harmonics(graph, vector, size) if encoding == "HARMONICS" else vector


def mixture_graph(shape: MixtureShape, snapshot: Snapshot) -> Graph:
    """A snapshot as a graph that gives what `inference.evaluate_mixtures` gives.

    Raises
    ------
    ValueError
        If the snapshot is not valid for `shape` (`Snapshot.validate`).
    """
    snapshot.validate(shape)
    graph = GraphBuilder()
    names = add_parameters(graph, shape, snapshot.parameters)
    is_smooth = shape.interpolation == "SMOOTH"
    place = encodings.contract(graph, graph.input("position", ("N", 3)), snapshot.bounds)
    u = encodings.unit(graph, graph.input("u", ("N",))) if shape.sees_u else ""
    parts = []
    if shape.position_encoding == "GRID":
        level = grid_levels(shape.resolutions, shape.level_offsets)
        parts.append(
            encodings.grids(graph, [place], level, names["table"][0], shape.level_features, is_smooth=is_smooth)
        )
    elif shape.position_encoding == "BLOB":
        across = graph.add("Sub", graph.add("Mul", place, graph.floats(2.0)), graph.floats(1.0))
        parts.append(encodings.blobs(graph, graph.add("Transpose", across, perm=(1, 0)), 3, shape.position_bins))
    if shape.plane_levels:
        level = grid_levels(shape.plane_resolutions, shape.plane_offsets)
        parts.append(
            encodings.planes(graph, place, u, level, names["planes"][0], shape.plane_features, is_smooth=is_smooth)
        )
    if shape.hash_levels:
        level = grid_levels(shape.hash_resolutions, shape.hash_offsets, shape.hash_size, 4)
        parts.append(
            encodings.grids(graph, [place, u], level, names["hashes"][0], shape.hash_features, is_smooth=is_smooth)
        )
    if shape.normal_encoding != "NONE":
        parts.append(_direction(graph, "normal", shape.normal_encoding, shape.normal_size))
    if shape.wo_encoding != "NONE":
        parts.append(_direction(graph, "wo", shape.wo_encoding, shape.wo_size))
    if shape.roughness_bins:
        rough = encodings.unit(graph, graph.input("roughness", ("N",)))
        seen = graph.add("Exp", graph.add("Neg", graph.add("Transpose", rough, perm=(1, 0))))
        seen = graph.add("Sub", graph.floats(1.0), graph.add("Mul", graph.floats(2.0), seen))
        parts.append(encodings.blobs(graph, seen, 1, shape.roughness_bins))
    if shape.u_frequencies:
        parts.append(encodings.frequencies(graph, u, shape.u_frequencies))
    spare = shape.feature_width - shape.used_width
    features = parts[0] if len(parts) == 1 else graph.add("Concat", *parts, axis=1)
    if spare:
        features = graph.add("Pad", features, graph.integers([0, 0, 0, spare]), graph.floats(1.0))
    value = encodings.layers(
        graph, features, [*names["input_weights"], *names["hidden_weights"], *names["output_weights"]]
    )
    value = graph.clip(value, -float(RAW_LIMIT), float(RAW_LIMIT), if_nan=0.0)
    graph.output("raw", value, ("N", shape.output_width))
    return graph.graph("mixture", _DOC)
