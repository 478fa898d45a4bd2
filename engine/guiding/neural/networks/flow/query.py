# SPDX-License-Identifier: GPL-3.0-or-later
"""Conditioning the flow on a vertex, sampling it and evaluating its density.

A direction is a point (a, b) of the unit square: z = 1 - 2 a, azimuth 2 pi b; areas are solid angles over 4 pi. From
directions to uniform random numbers, layer 0 comes first: it moves b, knowing a; layer 1 moves a, knowing the new b.
Sampling goes back. Both ways read a layer's distribution from the same place (`_shape_layer`), so what differs between
them is rounding.

References
----------
Müller et al. 2019, "Neural Importance Sampling", sections 3 (coupling layers), 4.2 (piecewise-quadratic ones) and 4.3
(one-blob encoding).
"""

import math

import numpy as np

from engine.guiding.neural.networks.encoding import blob, contract
from engine.guiding.neural.networks.flow.field import BLOB_COUNT, BLOB_FIRST, SPLINE_EDGE, SPLINE_HEIGHT, SPLINE_SUM
from engine.guiding.neural.networks.flow.shape import ACTIVATION_LIMIT, LOGIT_LIMIT, MIN_WIDTH, UNIFORM_SHARE
from engine.guiding.records.training_rows import ROW_NORMAL, ROW_POSITION, ROW_ROUGHNESS, ROW_WI, ROW_WO
from engine.kernels.constants import FLOAT_MAX, INV_FOUR_PI, INV_TWO_PI, ONE_MINUS_EPSILON, TWO_PI
from engine.kernels.exponential import exp_nonpositive
from engine.runtime.jit import kernel

_ACTIVATION_LIMIT = np.float32(ACTIVATION_LIMIT)
_LOGIT_LIMIT = np.float32(LOGIT_LIMIT)
_MIN_WIDTH = np.float32(MIN_WIDTH)
_UNIFORM_SHARE = np.float32(UNIFORM_SHARE)

#: A direction's coordinates beyond this are not a direction's.
_COORDINATE_LIMIT = np.float32(1.001)
#: Part of the prediction that comes evenly from all directions, as in the mixture field.
_EVEN_SHARE = np.float32(0.3)


@kernel
def _between(x, limit):
    """Clamp to [-limit, limit]; 0 for NaN."""
    if x > limit:
        return limit
    if x < -limit:
        return -limit
    return x if x == x else np.float32(0.0)


@kernel
def _vertex_coordinate(network, k, p, n, wo, roughness):
    """Coordinate k of what the flow is conditioned on, in [-1, 1] whatever comes in."""
    if k < 3:
        position = p[0] if k == 0 else (p[1] if k == 1 else p[2])
        return 2.0 * contract(position, network.center[k], network.inverse_extent[k]) - 1.0
    if k < 6:
        value = wo[0] if k == 3 else (wo[1] if k == 4 else wo[2])
    elif k < 9:
        value = n[0] if k == 6 else (n[1] if k == 7 else n[2])
    else:
        value = 2.0 * roughness - 1.0
    return _between(value, 1.0)


@kernel
def direction_to_square(wi):
    """Point of the unit square that stands for a unit direction: (float32, float32) in [0, 1).

    Heights are measured from the nearer pole, where 1 - |z| has lost its digits and x and y have not.
    """
    squared = wi[0] * wi[0] + wi[1] * wi[1]
    below = 0.5 * squared / (1.0 + abs(wi[2]))
    a = below if wi[2] >= 0.0 else 1.0 - below
    b = math.atan2(wi[1], wi[0]) * INV_TWO_PI
    b = b + 1.0 if b < 0.0 else b
    return min(max(a, 0.0), ONE_MINUS_EPSILON), min(max(b, 0.0), ONE_MINUS_EPSILON)


@kernel
def square_to_direction(a, b):
    """Unit direction of a point of the unit square: float32 tuple."""
    sine = 2.0 * math.sqrt(a * (1.0 - a))
    return sine * math.cos(TWO_PI * b), sine * math.sin(TWO_PI * b), 1.0 - 2.0 * a


@kernel
def prepare_flow(guide, lane, p, n, wo, roughness, fluence):
    """Condition lane `lane` of `guide` on a vertex: the first layers' sums over all but the coordinate left alone.

    Parameters
    ----------
    guide : FlowGuide
    lane : int
    p : float32 tuple, world [m]
    n : float32 tuple, unit, on the side that is lit
    wo : float32 tuple, unit, outward, world
    roughness : float32 in [0, 1]
    fluence : float32, integral over directions of what the flow is the density of; for `predict_flow`
    """
    network = guide.network
    width = network.passed_weights.shape[2]
    latent_width = guide.latent.shape[1]
    for j in range(latent_width):
        guide.latent[lane, j] = 0.0
    for k in range(network.blobs.shape[0]):
        coordinate = _vertex_coordinate(network, k, p, n, wo, roughness)
        first, a, b, c = blob(coordinate, network.blobs[k, BLOB_COUNT])
        first += network.blobs[k, BLOB_FIRST]
        for layer in range(network.passed_weights.shape[0]):
            start = layer * width
            for j in range(width):
                guide.latent[lane, start + j] += (
                    a * network.condition_weights[layer, first, j]
                    + b * network.condition_weights[layer, first + 1, j]
                    + c * network.condition_weights[layer, first + 2, j]
                )
    guide.fluence[lane] = min(fluence, FLOAT_MAX) if fluence > 0.0 else np.float32(0.0)


@kernel
def _activate(guide, lane, side):
    """Clamp activations to [0, ACTIVATION_LIMIT]; 0 for NaN."""
    for j in range(guide.hidden.shape[2]):
        value = guide.hidden[lane, side, j]
        value = value if value > 0.0 else np.float32(0.0)
        guide.hidden[lane, side, j] = value if value < _ACTIVATION_LIMIT else _ACTIVATION_LIMIT


@kernel
def _run_perceptron(guide, lane, layer, passed):
    """A layer's perceptron at `passed` in [0, 1], to guide.outputs[lane]."""
    network = guide.network
    width = network.passed_weights.shape[2]
    first, a, b, c = blob(2.0 * passed - 1.0, network.passed_weights.shape[1])
    for j in range(width):
        guide.hidden[lane, 0, j] = guide.latent[lane, layer * width + j] + (
            a * network.passed_weights[layer, first, j]
            + b * network.passed_weights[layer, first + 1, j]
            + c * network.passed_weights[layer, first + 2, j]
        )
    _activate(guide, lane, 0)
    inner_count = network.hidden_weights.shape[0] // network.passed_weights.shape[0]
    for inner in range(inner_count):
        source = inner & 1
        target = 1 - source
        matrix = layer * inner_count + inner
        for j in range(width):
            guide.hidden[lane, target, j] = 0.0
        for i in range(width):
            value = guide.hidden[lane, source, i]
            # About half of them are zero.
            if value > 0.0:
                for j in range(width):
                    guide.hidden[lane, target, j] += value * network.hidden_weights[matrix, i, j]
        _activate(guide, lane, target)
    source = inner_count & 1
    output_width = network.output_bias.shape[1]
    for j in range(output_width):
        guide.outputs[lane, j] = network.output_bias[layer, j]
    for i in range(width):
        value = guide.hidden[lane, source, i]
        if value > 0.0:
            for j in range(output_width):
                guide.outputs[lane, j] += value * network.output_weights[layer, i, j]


@kernel
def _shape_layer(guide, lane, layer, passed):
    """Write a layer's distribution, given the coordinate it leaves alone, to guide.spline[lane].

    The density is linear over each bin: exponentials of the outputs at the edges, divided by their integral over bins
    whose widths are a softmax (Müller et al. 2019, section 4.2); both mixed with a little of the even ones.
    """
    _run_perceptron(guide, lane, layer, passed)
    bin_count = guide.spline.shape[2] - 1
    largest_width = -_LOGIT_LIMIT
    largest_height = -_LOGIT_LIMIT
    for k in range(bin_count):
        logit = _between(guide.outputs[lane, k], _LOGIT_LIMIT)
        guide.outputs[lane, k] = logit
        largest_width = max(largest_width, logit)
    for k in range(bin_count + 1):
        logit = _between(guide.outputs[lane, bin_count + k], _LOGIT_LIMIT)
        guide.outputs[lane, bin_count + k] = logit
        largest_height = max(largest_height, logit)

    total = np.float32(0.0)
    for k in range(bin_count):
        share = exp_nonpositive(guide.outputs[lane, k] - largest_width)
        guide.outputs[lane, k] = share
        total += share
    for k in range(bin_count + 1):
        guide.spline[lane, SPLINE_HEIGHT, k] = exp_nonpositive(guide.outputs[lane, bin_count + k] - largest_height)
    scale = (1.0 - np.float32(bin_count) * _MIN_WIDTH) / total
    edge = np.float32(0.0)
    for k in range(bin_count):
        guide.spline[lane, SPLINE_EDGE, k] = edge
        edge += _MIN_WIDTH + scale * guide.outputs[lane, k]
    # The last bin takes what rounding left over.
    guide.spline[lane, SPLINE_EDGE, bin_count] = 1.0

    area = np.float32(0.0)
    for k in range(bin_count):
        guide.spline[lane, SPLINE_SUM, k] = area
        width = guide.spline[lane, SPLINE_EDGE, k + 1] - guide.spline[lane, SPLINE_EDGE, k]
        heights = guide.spline[lane, SPLINE_HEIGHT, k] + guide.spline[lane, SPLINE_HEIGHT, k + 1]
        area += 0.5 * width * heights
    scale = (1.0 - _UNIFORM_SHARE) / area
    for k in range(bin_count):
        edge = guide.spline[lane, SPLINE_EDGE, k]
        guide.spline[lane, SPLINE_SUM, k] = _UNIFORM_SHARE * edge + scale * guide.spline[lane, SPLINE_SUM, k]
    guide.spline[lane, SPLINE_SUM, bin_count] = 1.0
    for k in range(bin_count + 1):
        guide.spline[lane, SPLINE_HEIGHT, k] = _UNIFORM_SHARE + scale * guide.spline[lane, SPLINE_HEIGHT, k]


@kernel
def _find_bin(guide, lane, row, value):
    """The last bin that begins at or below `value`, in a row of the spline."""
    low = 0
    high = guide.spline.shape[2] - 1
    while high - low > 1:
        middle = (low + high) >> 1
        if guide.spline[lane, row, middle] <= value:
            low = middle
        else:
            high = middle
    return low


@kernel
def _move(guide, lane, x):
    """The spline's distribution function at x, and its density there: float32 in [0, 1), float32.

    References: Müller et al. 2019, section 4.2 (the integral of the linear density up to x).
    """
    k = _find_bin(guide, lane, SPLINE_EDGE, x)
    left = guide.spline[lane, SPLINE_EDGE, k]
    width = guide.spline[lane, SPLINE_EDGE, k + 1] - left
    t = min(max((x - left) / width, 0.0), 1.0)
    height = guide.spline[lane, SPLINE_HEIGHT, k]
    rise = guide.spline[lane, SPLINE_HEIGHT, k + 1] - height
    y = guide.spline[lane, SPLINE_SUM, k] + width * t * (height + 0.5 * rise * t)
    return min(y, ONE_MINUS_EPSILON), height + rise * t


@kernel
def _move_back(guide, lane, y):
    """Where the spline's distribution function is y: float32 in [0, 1)."""
    k = _find_bin(guide, lane, SPLINE_SUM, y)
    left = guide.spline[lane, SPLINE_EDGE, k]
    width = guide.spline[lane, SPLINE_EDGE, k + 1] - left
    height = guide.spline[lane, SPLINE_HEIGHT, k]
    rise = guide.spline[lane, SPLINE_HEIGHT, k + 1] - height
    # rise t^2 / 2 + height t = mean: the root in the form that nothing cancels in, whichever way the density goes.
    mean = (y - guide.spline[lane, SPLINE_SUM, k]) / width
    root = math.sqrt(max(height * height + 2.0 * rise * mean, 0.0))
    t = min(max(2.0 * mean / (height + root), 0.0), 1.0)
    return min(left + t * width, ONE_MINUS_EPSILON)


@kernel
def flow_to_uniform(guide, lane, a, b):
    """Take a point of the square through all layers: where it lands, and the density there over the unit square.

    References: Müller et al. 2019, section 3 (the density of a composition is the product of its parts').
    """
    density = np.float32(1.0)
    for layer in range(guide.network.passed_weights.shape[0]):
        moves_b = (layer & 1) == 0
        _shape_layer(guide, lane, layer, a if moves_b else b)
        moved, factor = _move(guide, lane, b if moves_b else a)
        a = a if moves_b else moved
        b = moved if moves_b else b
        density *= factor
    return a, b, density


@kernel
def flow_from_uniform(guide, lane, a, b):
    """Take a point of the square back through all layers: the inverse of `flow_to_uniform`."""
    layer_count = guide.network.passed_weights.shape[0]
    for step in range(layer_count):
        layer = layer_count - 1 - step
        moves_b = (layer & 1) == 0
        _shape_layer(guide, lane, layer, a if moves_b else b)
        moved = _move_back(guide, lane, b if moves_b else a)
        a = a if moves_b else moved
        b = moved if moves_b else b
    return a, b


@kernel
def eval_flow(guide, lane, wi):
    """Density of `sample_flow` at unit direction wi: float32 [sr^-1], positive; 0 if wi is no direction."""
    size = max(abs(wi[0]), max(abs(wi[1]), abs(wi[2])))
    is_direction = size <= _COORDINATE_LIMIT and wi[0] == wi[0] and wi[1] == wi[1] and wi[2] == wi[2]
    if not is_direction:
        return np.float32(0.0)
    a, b = direction_to_square(wi)
    _, _, density = flow_to_uniform(guide, lane, a, b)
    return INV_FOUR_PI * density


@kernel
def sample_flow(guide, lane, u0, u1, u2):
    """Draw a unit direction from lane `lane` of `guide`: float32 tuple; `eval_flow` is its density.

    Parameters
    ----------
    guide : FlowGuide
    lane : int
    u0, u1, u2 : float32 in [0, 1): height, azimuth; the third is not used
    """
    a = u0 if (u0 >= 0.0 and u0 < 1.0) else np.float32(0.5)
    b = u1 if (u1 >= 0.0 and u1 < 1.0) else np.float32(0.5)
    a, b = flow_from_uniform(guide, lane, a, b)
    return square_to_direction(a, b)


@kernel
def predict_flow(guide, lane, wi, guide_pdf):
    """Incident radiance along unit direction wi (mean over channels), given `guide_pdf` = `eval_flow`.

    For flows that are proportional to it, not to a product.

    Fluence times density, part of it held even, for the reason given at `predict_vmm`. It takes `wi` as the other
    predictors do; the density knows all.
    """
    density = guide_pdf if guide_pdf > 0.0 else np.float32(0.0)
    density = (1.0 - _EVEN_SHARE) * min(density, FLOAT_MAX) + _EVEN_SHARE * INV_FOUR_PI
    return min(guide.fluence[lane] * density, FLOAT_MAX)


@kernel
def encode_flow_rows(network, rows, condition, square):
    """Features of records, for training.

    Parameters
    ----------
    network : FlowField
    rows : float32 (N, ROW_PDF + 1 or more), ROW_*
    condition : float32 (N, condition_width), written
    square : float32 (N, 2), written: `direction_to_square` of wi
    """
    for row in range(rows.shape[0]):
        for j in range(condition.shape[1]):
            condition[row, j] = 0.0
        p = (rows[row, ROW_POSITION], rows[row, ROW_POSITION + 1], rows[row, ROW_POSITION + 2])
        n = (rows[row, ROW_NORMAL], rows[row, ROW_NORMAL + 1], rows[row, ROW_NORMAL + 2])
        wo = (rows[row, ROW_WO], rows[row, ROW_WO + 1], rows[row, ROW_WO + 2])
        for k in range(network.blobs.shape[0]):
            coordinate = _vertex_coordinate(network, k, p, n, wo, rows[row, ROW_ROUGHNESS])
            first, a, b, c = blob(coordinate, network.blobs[k, BLOB_COUNT])
            first += network.blobs[k, BLOB_FIRST]
            condition[row, first] = a
            condition[row, first + 1] = b
            condition[row, first + 2] = c
        wi = (rows[row, ROW_WI], rows[row, ROW_WI + 1], rows[row, ROW_WI + 2])
        square[row, 0], square[row, 1] = direction_to_square(wi)
