# SPDX-License-Identifier: GPL-3.0-or-later
"""What kernels read of the flow, and what they keep for each lane."""

from __future__ import annotations

from typing import Any, cast

import numpy as np

from engine.array_types import Float32Array, Int64Array, Uint8Array
from engine.guiding.neural.networks.encoding import center_and_scale
from engine.guiding.neural.networks.flow.shape import FlowShape
from engine.guiding.neural.networks.radiance import Snapshot
from engine.runtime.bundle import Bundle

# Columns of FlowField.blobs
BLOB_FIRST = 0
BLOB_COUNT = 1

# Rows of FlowGuide.spline: edges of the bins, the density there, and the distribution function there.
SPLINE_EDGE = 0
SPLINE_HEIGHT = 1
SPLINE_SUM = 2
SPLINE_ROWS = 3


class FlowField(Bundle):
    """The flow's parameters, with the sizes of a `FlowShape`: S layers, C features of the vertex.

    blobs : int64 (10, 2), BLOB_*: features of each coordinate of the vertex (position, wo, normal, roughness)
    center, inverse_extent : float32 (3,), of the bounds: middle [m] and 2 / extent [m^-1]
    condition_weights : float32 (S, C, width), the first layers' rows for the vertex
    passed_weights : float32 (S, blob_bins, width), their rows for the coordinate left alone
    hidden_weights : float32 (S * (hidden_layers - 1), width, width)
    output_weights : float32 (S, width, 2 * bin_count + 1), to the bins' widths, then to the heights of their edges
    output_bias : float32 (S, 2 * bin_count + 1)
    is_ready : uint8 (1,), 0 = never trained: use the BSDF (the flow is uniform)
    """

    blobs: Int64Array
    center: Float32Array
    inverse_extent: Float32Array
    condition_weights: Float32Array
    passed_weights: Float32Array
    hidden_weights: Float32Array
    output_weights: Float32Array
    output_bias: Float32Array
    is_ready: Uint8Array


def view_flow_field(shape: FlowShape, bounds: Float32Array, parameters: Float32Array, is_ready: bool) -> FlowField:
    """`FlowField` over views of `parameters`: what is written there later, the kernels see.

    Parameters
    ----------
    bounds : float32 (2, 3) [m]
    parameters : float32 (parameter_count,)
    """
    bins = np.array(shape.condition_bins, np.int64)
    center, inverse_extent = center_and_scale(bounds)
    return FlowField(
        blobs=np.stack((np.cumsum(bins) - bins, bins), axis=1),
        center=center,
        inverse_extent=inverse_extent,
        is_ready=np.array([is_ready], np.uint8),
        **shape.split(parameters),
    )


def make_flow_field(shape: FlowShape, snapshot: Snapshot) -> FlowField:
    """A trained flow of its own memory.

    Raises
    ------
    ValueError
        If the snapshot's sizes are not those of `shape`, or anything in it is not finite.
    """
    # The check asks a shape for nothing but its number of parameters.
    snapshot.validate(cast(Any, shape))
    return view_flow_field(shape, snapshot.bounds, snapshot.parameters.copy(), True)


def no_flow_field(shape: FlowShape) -> FlowField:
    """A uniform flow, to stand where there is none."""
    bounds = np.array(((-1.0,) * 3, (1.0,) * 3), np.float32)
    return view_flow_field(shape, bounds, np.zeros(shape.parameter_count, np.float32), False)


class FlowGuide(Bundle):
    """A flow ready for sampling at given vertices, L lanes of S layers. A lane is for one thread at a time.

    network : FlowField
    latent : float32 (L, S * width), what the first layers make of the vertex
    fluence : float32 (L,), integral over directions of what the flow is the density of
    hidden : float32 (L, 2, width), scratch: activations
    outputs : float32 (L, 2 * bin_count + 1), scratch
    spline : float32 (L, SPLINE_ROWS, bin_count + 1), scratch: the distribution of the layer last looked at
    """

    network: FlowField
    latent: Float32Array
    fluence: Float32Array
    hidden: Float32Array
    outputs: Float32Array
    spline: Float32Array


def allocate_flow_guide(network: FlowField, lane_count: int) -> FlowGuide:
    """Zeroed `FlowGuide` for `lane_count` lanes; for another flow of the same shape, `_replace(network=...)`."""
    layer_count, _, width = network.passed_weights.shape
    output_width = network.output_bias.shape[1]
    return FlowGuide(
        network,
        np.zeros((lane_count, layer_count * width), np.float32),
        np.zeros(lane_count, np.float32),
        np.zeros((lane_count, 2, width), np.float32),
        np.zeros((lane_count, output_width), np.float32),
        np.zeros((lane_count, SPLINE_ROWS, (output_width + 1) // 2), np.float32),
    )
