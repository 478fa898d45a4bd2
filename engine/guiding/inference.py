# SPDX-License-Identifier: GPL-3.0-or-later
"""Evaluating the radiance network while rendering: kernels encode and do the first layer, onnxruntime the others.

The first layer is where candidates of one vertex have most in common: the grid's features and their part of the layer
are computed once a vertex, and a candidate adds nine rows of the direction's weights. What is left is a plain
perceptron on batches small enough to stay in cache.
"""

from __future__ import annotations

import math

import numpy as np
import onnx
import onnxruntime
from onnx import TensorProto, helper, numpy_helper

from engine.guiding.encoding import Encoding, first_layer, make_encoding
from engine.guiding.network import LOG_RADIANCE_LIMIT, NetworkShape, Snapshot
from engine.scene.arrays import Float32Array, Int64Array

#: Candidates a batch: two batches of activations of 64 floats fit into half of a 512 KiB level-2 cache.
BATCH_SIZE = 1024

_INPUT = "hidden"
_OUTPUT = "radiance"


def _onnx_model(shape: NetworkShape, snapshot: Snapshot) -> bytes:
    """The layers after the first: activations (N, width) to radiance (N, channels)."""
    arrays = shape.split(snapshot.parameters)
    nodes, constants = [], []

    def constant(name: str, value: Float32Array) -> str:
        constants.append(numpy_helper.from_array(np.ascontiguousarray(value), name))
        return name

    value = _INPUT
    for index in range(shape.hidden_layers - 1):
        weights = constant(f"weights_{index}", arrays["hidden_weights"][index])
        nodes.append(helper.make_node("Gemm", [value, weights], [f"sum_{index}"]))
        nodes.append(helper.make_node("Relu", [f"sum_{index}"], [f"hidden_{index}"]))
        value = f"hidden_{index}"
    weights = constant("output_weights", arrays["output_weights"])
    # exp(y) * scale = exp(y + log(scale)): the Gemm adds it for nothing, and the limits move along.
    log_scale = math.log(snapshot.scale)
    bias = constant("log_scale", np.full(shape.channel_count, log_scale, np.float32))
    least = constant("least", np.array(log_scale - LOG_RADIANCE_LIMIT, np.float32))
    most = constant("most", np.array(log_scale + LOG_RADIANCE_LIMIT, np.float32))
    nodes.append(helper.make_node("Gemm", [value, weights, bias], ["sum"]))
    nodes.append(helper.make_node("Clip", ["sum", least, most], ["clipped"]))
    nodes.append(helper.make_node("Exp", ["clipped"], [_OUTPUT]))
    graph = helper.make_graph(
        nodes,
        "radiance",
        [helper.make_tensor_value_info(_INPUT, TensorProto.FLOAT, ["N", shape.width])],
        [helper.make_tensor_value_info(_OUTPUT, TensorProto.FLOAT, ["N", shape.channel_count])],
        constants,
    )
    # Versions that every onnxruntime since 1.13 reads, whichever onnx wrote it.
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
    onnx.checker.check_model(model)
    return model.SerializeToString()


class RadianceNetwork:
    """A snapshot made ready for use: immutable, and shared by all threads.

    Parameters
    ----------
    shape : NetworkShape
    snapshot : Snapshot

    Raises
    ------
    ValueError
        If the snapshot is not valid for `shape` (`Snapshot.validate`).
    """

    def __init__(self, shape: NetworkShape, snapshot: Snapshot) -> None:
        snapshot.validate(shape)
        self.shape = shape
        self.version = snapshot.version
        self.snapshot = snapshot
        self.encoding: Encoding = make_encoding(shape, snapshot.bounds, snapshot.parameters)
        options = onnxruntime.SessionOptions()
        # The calling thread does the work: the renderer has one for each core already.
        options.intra_op_num_threads = 1
        options.inter_op_num_threads = 1
        options.add_session_config_entry("session.intra_op.allow_spinning", "0")
        options.log_severity_level = 3
        self.session = onnxruntime.InferenceSession(
            _onnx_model(shape, snapshot), options, providers=["CPUExecutionProvider"]
        )


class RadianceInference:
    """Predictions for one thread: its own buffers over a network that it shares.

    Parameters
    ----------
    shape : NetworkShape
    batch_size : int
        Candidates handed to onnxruntime at once.
    """

    def __init__(self, shape: NetworkShape, batch_size: int = BATCH_SIZE) -> None:
        self.shape = shape
        self._hidden = np.zeros((batch_size, shape.width), np.float32)
        self._latent = np.zeros(shape.width, np.float32)
        self._network: RadianceNetwork | None = None
        self._binding: onnxruntime.IOBinding | None = None

    def load(self, network: RadianceNetwork | Snapshot) -> None:
        """Use `network` from now on; a snapshot is made ready first.

        Raises
        ------
        ValueError
            If the snapshot is not valid.
        """
        if isinstance(network, Snapshot):
            network = RadianceNetwork(self.shape, network)
        self._binding = network.session.io_binding()
        self._network = network

    @property
    def version(self) -> int:
        """Version of the snapshot in use, -1 without one."""
        return -1 if self._network is None else self._network.version

    def predict(
        self,
        positions: Float32Array,
        candidate_vertex: Int64Array,
        directions: Float32Array,
        candidate_count: int,
        out: Float32Array,
    ) -> None:
        """Incident radiance from candidate directions.

        Parameters
        ----------
        positions : float32 (V, 3), world [m]
        candidate_vertex : int (N,), row of `positions`; candidates of one vertex in a row share its latent
        directions : float32 (N, 3), unit, world space
        candidate_count : int, at most N
        out : float32 (N, channels), C-contiguous; the first `candidate_count` rows are written

        Raises
        ------
        RuntimeError
            Without a network.
        """
        network, binding = self._network, self._binding
        if network is None or binding is None:
            raise RuntimeError("no network is loaded")
        batch_size, width = self._hidden.shape
        channel_count = out.shape[1]
        for start in range(0, candidate_count, batch_size):
            stop = min(start + batch_size, candidate_count)
            first_layer(
                network.encoding, positions, directions, candidate_vertex, start, stop, self._latent, self._hidden
            )
            rows = stop - start
            binding.bind_input(_INPUT, "cpu", 0, np.float32, (rows, width), self._hidden.ctypes.data)
            binding.bind_output(
                _OUTPUT, "cpu", 0, np.float32, (rows, channel_count), out.ctypes.data + start * out.strides[0]
            )
            network.session.run_with_iobinding(binding)
