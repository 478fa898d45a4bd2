# SPDX-License-Identifier: GPL-3.0-or-later
"""Mixture networks while rendering: points in, raw parameters of mixtures out, all in kernels.

What the raw outputs mean is the lobe model's business (`engine.guiding.neural.networks.lobes`); the last of them may be
the logit of the share of directions that the mixture should propose.
"""

from __future__ import annotations

import numpy as np

from engine.array_types import Float32Array, Int64Array
from engine.guiding.neural.networks.mixture.features import MixtureEncoding, encode_features, make_mixture_encoding
from engine.guiding.neural.networks.mixture.shape import MixtureShape
from engine.guiding.neural.networks.perceptron import (
    CHUNK_ROWS,
    Perceptron,
    allocate_scratch,
    evaluate_chunk,
    pack_perceptron,
)
from engine.guiding.neural.networks.radiance import Snapshot
from engine.guiding.records.training_rows import SHUTTER_SPAN
from engine.runtime.bundle import Bundle
from engine.runtime.jit import kernel

#: Raw outputs stay within it: every activation that follows has long been saturated.
RAW_LIMIT = np.float32(1e4)

# Entries of MixtureNetwork.header
HEADER_IS_READY = 0
HEADER_LOBE_COUNT = 1
HEADER_OUTPUT_WIDTH = 2
HEADER_SELECTION = 3  # column of the selection's logit, -1 = none
HEADER_HAS_COSINE = 4  # whether the cosine is part of what was learned
HEADER_COUNT = 5


class MixtureNetwork(Bundle):
    """A network ready for use: immutable, and shared by all threads. Its type depends on the numbers of features that
    tables have for an entry, alone.

    header : int64 (HEADER_COUNT,), HEADER_*
    blend : float32 (1,), factor in [0, 1] of the learned share
    u_span : float32 (2,), u at the shutter's opening and closing
    encoding : MixtureEncoding
    perceptron : Perceptron
    """

    header: Int64Array
    blend: Float32Array
    u_span: Float32Array
    encoding: MixtureEncoding
    perceptron: Perceptron


def _make(
    shape: MixtureShape, bounds: Float32Array, parameters: Float32Array | None, blend: float,
    u_span: tuple[float, float],
) -> MixtureNetwork:
    header = np.zeros(HEADER_COUNT, np.int64)
    header[HEADER_IS_READY] = parameters is not None
    header[HEADER_LOBE_COUNT] = shape.lobe_count
    header[HEADER_OUTPUT_WIDTH] = shape.output_width
    header[HEADER_SELECTION] = shape.selection_column
    header[HEADER_HAS_COSINE] = shape.target != "RADIANCE"
    arrays = {} if parameters is None else shape.split(parameters)
    matrices = [] if parameters is None else shape.matrices(parameters)
    return MixtureNetwork(
        header,
        np.array([min(max(blend, 0.0), 1.0)], np.float32),
        np.array(u_span, np.float32),
        make_mixture_encoding(shape, bounds, arrays),
        pack_perceptron(matrices),
    )


def make_mixture_network(
    shape: MixtureShape, snapshot: Snapshot, blend: float = 1.0, u_span: tuple[float, float] = SHUTTER_SPAN
) -> MixtureNetwork:
    """A snapshot made ready for use; the grids stay a view of it.

    Parameters
    ----------
    blend : float
        Factor in [0, 1] of the learned share of the mixture (`shape.selection_blend`).
    u_span : (float, float)
        u at the shutter's opening and closing, where that is a part of what the network knows (`sequence_field`).

    Raises
    ------
    ValueError
        If the snapshot is not valid for `shape` (`Snapshot.validate`).
    """
    snapshot.validate(shape)
    return _make(shape, snapshot.bounds, snapshot.parameters, blend, u_span)


def no_mixture_network(shape: MixtureShape) -> MixtureNetwork:
    """A network that is not ready, to stand where there is none; of the same type as one of `shape` that is."""
    return _make(shape, np.array(((-1.0,) * 3, (1.0,) * 3), np.float32), None, 0.0, SHUTTER_SPAN)


def allocate_mixture_scratch(shape: MixtureShape) -> Float32Array:
    """Scratch of `evaluate_mixtures` for one thread: float32 (2 * CHUNK_ROWS, columns)."""
    return allocate_scratch(max(shape.feature_width, shape.width, shape.output_width))


@kernel
def u_of_time(network, time):
    """What the network knows a time of the shutter, in [0, 1], as: float32 in [0, 1]."""
    return network.u_span[0] + (network.u_span[1] - network.u_span[0]) * time


@kernel
def evaluate_mixtures(network, position, normal, wo, roughness, u, row_count, scratch, raw):
    """Raw parameters of the mixtures at a batch of points, and the logit of the selection after them.

    A row's result depends on that row alone, bit for bit. Whatever goes in, finite numbers come out: NaN becomes 0, all
    else is cut to ±RAW_LIMIT. All zero if the network is not ready.

    Parameters
    ----------
    network : MixtureNetwork
    position : float32 (N, 3) [m]
    normal : float32 (N, 3), unit shading normal on the viewer's side, world space
    wo : float32 (N, 3), unit, towards the viewer, world space
    roughness : float32 (N,), in [0, 1]
    u : float32 (N,), the further dimension, in [0, 1]
    row_count : int, rows to do, at most N
    scratch : float32 (2 * CHUNK_ROWS, columns), of `allocate_mixture_scratch`
    raw : float32 (at least row_count, output_width), written
    """
    if network.header[HEADER_IS_READY] == 0:
        for row in range(row_count):
            for j in range(raw.shape[1]):
                raw[row, j] = 0.0
        return
    for start in range(0, row_count, CHUNK_ROWS):
        stop = min(row_count, start + np.int64(CHUNK_ROWS))
        encode_features(network.encoding, position, normal, wo, roughness, u, start, stop, scratch)
        first = evaluate_chunk(network.perceptron, stop - start, scratch)
        for row in range(stop - start):
            for j in range(raw.shape[1]):
                value = scratch[first + row, j]
                cut = min(max(value, -RAW_LIMIT), RAW_LIMIT)
                raw[start + row, j] = cut if value == value else np.float32(0.0)


@kernel
def selection_probability(network, raw, row):
    """Share of directions that the mixture should propose, the BSDF the rest; 0 where nothing was learned of it.

    The logistic function of the last output times the blend: c' = b c of Huang et al. 2024, section 6.

    Parameters
    ----------
    raw : float32 (N, output_width), of `evaluate_mixtures`
    row : int

    Returns
    -------
    float32 in [0, 1]
    """
    column = network.header[HEADER_SELECTION]
    if column < 0 or network.header[HEADER_IS_READY] == 0:
        return np.float32(0.0)
    logit = min(max(raw[row, column], np.float32(-30.0)), np.float32(30.0))
    return network.blend[0] / (1.0 + np.exp(-logit))
