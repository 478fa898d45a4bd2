# SPDX-License-Identifier: GPL-3.0-or-later
"""The radiance network as kernels ask it, inside the compiled loop.

The first layer is where candidates of one vertex have most in common: the features of the position and of u and their
part of the layer are computed once a vertex, and a candidate adds nine rows of the direction's weights.
"""

from __future__ import annotations

import math

import numpy as np

from engine.array_types import Float32Array, Uint8Array
from engine.guiding.neural.networks.encoding import Encoding, accumulate_latent, accumulate_u, activate, make_encoding
from engine.guiding.neural.networks.perceptron import CHUNK_ROWS, Perceptron, evaluate_chunk, pack_perceptron
from engine.guiding.neural.networks.radiance import LOG_RADIANCE_LIMIT, NetworkShape, Snapshot
from engine.kernels.vector import load
from engine.runtime.bundle import Bundle
from engine.runtime.jit import kernel
from engine.spectral.wavelengths import WAVELENGTH_COUNT, hero_quarter

_LOG_LIMIT = np.float32(LOG_RADIANCE_LIMIT)


class NetworkField(Bundle):
    """A snapshot of the network.

    encoding : Encoding
    layers : Perceptron, all but the first layer
    log_scale : float32 (1,), logarithm of the radiance that the network's unit stands for
    is_ready : uint8 (1,), 0 = nothing has been learned
    by_quarter : uint8 (1,), 1 = outputs belong to the quarters of heroes (`NetworkShape.by_quarter`)
    """

    encoding: Encoding
    layers: Perceptron
    log_scale: Float32Array
    is_ready: Uint8Array
    by_quarter: Uint8Array


def make_network_field(shape: NetworkShape, snapshot: Snapshot) -> NetworkField:
    """Ready a snapshot for use.

    Raises
    ------
    ValueError
        If the snapshot is not valid for `shape` (`Snapshot.validate`).
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
    arrays = shape.split(parameters)
    return NetworkField(
        make_encoding(shape, bounds, parameters),
        pack_perceptron([*arrays["hidden_weights"], arrays["output_weights"]]),
        np.array([log_scale], np.float32),
        np.array([is_ready], np.uint8),
        np.array([shape.by_quarter], np.uint8),
    )


@kernel
def predict_network(network, positions, time, hero, candidate_vertex, directions, row_count, latent, scratch, out):
    """Incident radiance from candidate directions.

    Parameters
    ----------
    network : NetworkField
    positions : float32 (V, 3), world [m]
    time, hero : float32 (V,), in [0, 1], see `PathState`; the network sees one of them, if any, and only by quarter it
        is the hero
    candidate_vertex : int64 (>= row_count,)
        Row of the arrays above; candidates of one vertex in a row share its part of the first layer.
    directions : float32 (>= row_count, 3), unit, world
    latent : float32 (2, at least the width and that of u's features); scratch : float32, of `allocate_scratch`
        One thread's.
    out : float32 (>= row_count, C), written

    References
    ----------
    Rath et al. 2025, "Neural Resampling with Optimized Candidate Allocation", section 5.
    """
    log_scale = network.log_scale[0]
    sees_u = network.encoding.u_weights.shape[0] > 0
    by_quarter = network.by_quarter[0] != 0
    vertex = np.int64(-1)
    for start in range(0, row_count, CHUNK_ROWS):
        stop = min(start + CHUNK_ROWS, row_count)
        for row in range(start, stop):
            if candidate_vertex[row] != vertex:
                vertex = candidate_vertex[row]
                accumulate_latent(network.encoding, load(positions, vertex), latent, 0)
                if sees_u:
                    u = hero_quarter(hero[vertex])[1] if by_quarter else time[vertex]
                    accumulate_u(network.encoding, positions, vertex, u, latent, 0)
            activate(network.encoding, load(directions, row), latent, 0, scratch, row - start)
        first = evaluate_chunk(network.layers, stop - start, scratch)
        for row in range(start, stop):
            if by_quarter:
                quarter = hero_quarter(hero[candidate_vertex[row]])[0]
                for c in range(out.shape[1]):
                    output = (quarter + c) % WAVELENGTH_COUNT
                    out[row, c] = _radiance(scratch[first + row - start, output], log_scale)
            else:
                for c in range(out.shape[1]):
                    out[row, c] = _radiance(scratch[first + row - start, c], log_scale)


@kernel
def _radiance(value, log_scale):
    """Radiance of one of the last layer's outputs; NaN becomes the lower limit."""
    # Comparisons that NaN fails.
    value = value if value > -_LOG_LIMIT else -_LOG_LIMIT
    return math.exp(min(value, _LOG_LIMIT) + log_scale)
