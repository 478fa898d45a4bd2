# SPDX-License-Identifier: GPL-3.0-or-later
"""The radiance network as kernels ask it, inside the compiled loop.

The first layer is where candidates of one vertex have most in common: the grid's features and their part of the layer
are computed once a vertex, and a candidate adds nine rows of the direction's weights.
"""

from __future__ import annotations

import math

import numpy as np

from engine.bundle import Bundle
from engine.guiding.encoding import Encoding, accumulate_latent, activate, make_encoding
from engine.guiding.network import LOG_RADIANCE_LIMIT, NetworkShape, Snapshot
from engine.guiding.perceptron import VECTOR, multiply
from engine.jit import kernel
from engine.kernels.vector import load
from engine.scene.arrays import Float32Array, Uint8Array

#: Columns that the output layer is padded to: one vector register.
_OUTPUT_COLUMNS = VECTOR
_LOG_LIMIT = np.float32(LOG_RADIANCE_LIMIT)

#: Candidates that go through the layers together: their activations stay in the first-level cache.
_CHUNK = 24
# Rows of the scratch of `predict_network`: the activations of one layer and of the next.
_EVEN = 0
_ODD = _CHUNK
SCRATCH_ROWS = _ODD + _CHUNK


class NetworkField(Bundle):
    """A snapshot of the network.

    encoding : Encoding
    hidden_weights : float32 (layers - 1, width, width)
    output_weights : float32 (1, width, _OUTPUT_COLUMNS), columns beyond the channels are 0
    log_scale : float32 (1,), logarithm of the radiance that the network's unit stands for
    is_ready : uint8 (1,), 0 = nothing has been learned
    """

    encoding: Encoding
    hidden_weights: Float32Array
    output_weights: Float32Array
    log_scale: Float32Array
    is_ready: Uint8Array


def make_network_field(shape: NetworkShape, snapshot: Snapshot) -> NetworkField:
    """Ready a snapshot for use.

    Raises
    ------
    ValueError
        If the snapshot is not valid for `shape` (`Snapshot.validate`), or has more channels than a register holds.
    """
    snapshot.validate(shape)
    return _field(shape, snapshot.bounds, snapshot.parameters, math.log(snapshot.scale), is_ready=True)


def no_network(shape: NetworkShape) -> NetworkField:
    """A field that has learned nothing, of the type that one of `shape` has."""
    bounds = np.array(((0.0, 0.0, 0.0), (1.0, 1.0, 1.0)), np.float32)
    return _field(shape, bounds, np.zeros(shape.parameter_count, np.float32), 0.0, is_ready=False)


def _field(
    shape: NetworkShape, bounds: Float32Array, parameters: Float32Array, log_scale: float, *, is_ready: bool
) -> NetworkField:
    if shape.channel_count > _OUTPUT_COLUMNS:
        raise ValueError(f"channel_count is {shape.channel_count}: choose at most {_OUTPUT_COLUMNS}")
    arrays = shape.split(parameters)
    output_weights = np.zeros((1, shape.width, _OUTPUT_COLUMNS), np.float32)
    output_weights[0, :, : shape.channel_count] = arrays["output_weights"]
    return NetworkField(
        make_encoding(shape, bounds, parameters),
        np.ascontiguousarray(arrays["hidden_weights"]),
        output_weights,
        np.array([log_scale], np.float32),
        np.array([is_ready], np.uint8),
    )


@kernel
def predict_network(network, positions, candidate_vertex, directions, row_count, latent, scratch, out):
    """Incident radiance from candidate directions.

    Parameters
    ----------
    network : NetworkField
    positions : float32 (V, 3), world [m]
    candidate_vertex : int64 (>= row_count,)
        Row of `positions`; candidates of one vertex in a row share its part of the first layer.
    directions : float32 (>= row_count, 3), unit, world
    latent : float32 (1, at least the width); scratch : float32 (SCRATCH_ROWS, at least the width)
        One thread's.
    out : float32 (>= row_count, C), written

    References
    ----------
    Rath et al. 2025, "Neural Resampling with Optimized Candidate Allocation", section 5.
    """
    log_scale = network.log_scale[0]
    vertex = np.int64(-1)
    for start in range(0, row_count, _CHUNK):
        stop = min(start + _CHUNK, row_count)
        for row in range(start, stop):
            if candidate_vertex[row] != vertex:
                vertex = candidate_vertex[row]
                accumulate_latent(network.encoding, load(positions, vertex), latent, 0)
            activate(network.encoding, load(directions, row), latent, 0, scratch, _EVEN + row - start)
        layers = _EVEN
        for layer in range(network.hidden_weights.shape[0]):
            multiply(scratch, layers, stop - start, network.hidden_weights, layer, scratch, _ODD - layers)
            layers = _ODD - layers
        outputs = _ODD - layers
        multiply(scratch, layers, stop - start, network.output_weights, 0, scratch, outputs)
        for row in range(start, stop):
            for c in range(out.shape[1]):
                value = min(max(scratch[outputs + row - start, c], -_LOG_LIMIT), _LOG_LIMIT)
                out[row, c] = math.exp(value + log_scale)
