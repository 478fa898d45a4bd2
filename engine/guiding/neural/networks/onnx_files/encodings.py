# SPDX-License-Identifier: GPL-3.0-or-later
"""How networks see positions, directions and u, as parts of an ONNX graph.

Each function stands beside a kernel and gives what it gives, within float32's error: those of `networks.encoding`,
`networks.grids` and `networks.mixture.features`. Axes come first, and points last: `(axes, levels, N)`, and `(corners,
levels, N)`. What is picked and what numbers of a level are applied to then lies in long rows.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product

import numpy as np

from engine.array_types import Int64Array
from engine.guiding.neural.networks.encoding import HASH_Y, HASH_Z, center_and_scale
from engine.guiding.neural.networks.grids import LEVEL_FIRST, LEVEL_HASH_MASK, LEVEL_RESOLUTION, PLANES
from engine.guiding.neural.networks.mixture.features import HASH_U
from engine.guiding.neural.networks.onnx_files.graph import GraphBuilder
from engine.guiding.neural.networks.radiance import INNER_EXTENT

#: Multipliers of a grid point's coordinates where points share entries by a hash.
_PRIMES = (1, int(HASH_Y), int(HASH_Z), int(HASH_U))

#: Terms of the real spherical harmonics, factor and powers of x, y and z (`features._write_harmonics`).
_HARMONICS: tuple[tuple[tuple[float, int, int, int], ...], ...] = (
    ((0.28209479, 0, 0, 0),),
    ((-0.48860251, 0, 1, 0),),
    ((0.48860251, 0, 0, 1),),
    ((-0.48860251, 1, 0, 0),),
    ((1.09254843, 1, 1, 0),),
    ((-1.09254843, 0, 1, 1),),
    ((0.94617470, 0, 0, 2), (-0.31539157, 0, 0, 0)),
    ((-1.09254843, 1, 0, 1),),
    ((0.54627422, 2, 0, 0), (-0.54627422, 0, 2, 0)),
    ((-3.0 * 0.59004359, 2, 1, 0), (0.59004359, 0, 3, 0)),
    ((2.89061144, 1, 1, 1),),
    ((-5.0 * 0.45704580, 0, 1, 2), (0.45704580, 0, 1, 0)),
    ((5.0 * 0.37317633, 0, 0, 3), (-3.0 * 0.37317633, 0, 0, 1)),
    ((-5.0 * 0.45704580, 1, 0, 2), (0.45704580, 1, 0, 0)),
    ((1.44530572, 2, 0, 1), (-1.44530572, 0, 2, 1)),
    ((-0.59004359, 3, 0, 0), (3.0 * 0.59004359, 1, 2, 0)),
)


def contract(graph: GraphBuilder, position: str, bounds: np.ndarray) -> str:
    """Positions (N, 3) [m] as coordinates (3, N) in the unit cube of bounds float32 (2, 3) [m]: `encoding.contract`."""
    center, inverse_extent = center_and_scale(bounds)
    outer = np.float32(1.0 - INNER_EXTENT)
    u = graph.add("Sub", graph.add("Transpose", position, perm=(1, 0)), graph.floats(center[:, None]))
    u = graph.add("Mul", u, graph.floats(inverse_extent[:, None]))
    size = graph.add("Abs", u)
    rest = graph.add("Div", graph.floats(outer), graph.add("Max", size, graph.floats(1.0)))
    far = graph.add("Mul", graph.add("Sign", u), graph.add("Sub", graph.floats(1.0), rest))
    near = graph.add("Mul", u, graph.floats(INNER_EXTENT))
    u = graph.add("Where", graph.add("Greater", size, graph.floats(1.0)), far, near)
    u = graph.add("Add", graph.floats(0.5), graph.add("Mul", graph.floats(0.5), u))
    return graph.clip(u, 0.0, 1.0, if_nan=0.5)


def unit(graph: GraphBuilder, u: str) -> str:
    """Numbers (N,) cut to [0, 1] as a row (1, N): `encoding.unit`."""
    return graph.add("Unsqueeze", graph.clip(u, 0.0, 1.0, if_nan=0.0), graph.integers([0]))


def blobs(graph: GraphBuilder, coordinates: str, axis_count: int, bin_count: int) -> str:
    """Coordinates (N, axes) in [-1, 1] as features (N, axes * bins): `encoding.blob`.

    The kernel's three shares are a quadratic B-spline round each bin, here the difference of two parabolas.
    """
    # How far each coordinate is from the middle of each of its bins, in bins.
    half = 0.5 * (bin_count - 2)
    steps = np.kron(np.eye(axis_count), np.full((1, bin_count), half))
    middles = np.tile(np.arange(bin_count) - 0.5, axis_count)
    away = graph.add("Abs", graph.add("Gemm", coordinates, graph.floats(steps), graph.floats(half - middles)))
    wide = graph.add("Relu", graph.add("Sub", graph.floats(1.5), away))
    narrow = graph.add("Relu", graph.add("Sub", graph.floats(0.5), away))
    wide = graph.add("Mul", graph.add("Mul", wide, wide), graph.floats(0.5))
    narrow = graph.add("Mul", graph.add("Mul", narrow, narrow), graph.floats(1.5))
    return graph.add("Sub", wide, narrow)


def frequencies(graph: GraphBuilder, u: str, count: int) -> str:
    """u (1, N) in [0, 1] as features (N, 2 * count): `encoding.write_frequencies`."""
    octaves = np.float32(np.pi) * np.exp2(np.arange(count))
    angle = graph.add("Mul", graph.add("Transpose", u, perm=(1, 0)), graph.floats(octaves))
    both = [graph.add("Unsqueeze", graph.add(op, angle), graph.integers([2])) for op in ("Sin", "Cos")]
    return graph.reshape(graph.add("Concat", *both, axis=2), (0, 2 * count))


def _cells(graph: GraphBuilder, coordinates: str, resolutions: Int64Array, *, is_smooth: bool) -> tuple[str, str]:
    """Cells along each axis, of coordinates (axes, 1 or levels, N) in [0, 1] for levels of such resolutions: whole
    numbers and fractions, float32 (axes, levels, N) both: `grids.smooth_cell`.
    """
    x = graph.add("Mul", coordinates, graph.floats(resolutions[:, None]))
    cell = graph.add("Min", graph.add("Floor", x), graph.floats(resolutions[:, None] - 1))
    fraction = graph.add("Sub", x, cell)
    if is_smooth:
        square = graph.add("Mul", fraction, fraction)
        rest = graph.add("Sub", graph.floats(3.0), graph.add("Mul", graph.floats(2.0), fraction))
        fraction = graph.add("Mul", square, rest)
    return cell, fraction


def _corner_products(graph: GraphBuilder, op_type: str, lower: str, upper: str, axis_count: int) -> str:
    """For every corner of a cell, the first axis fastest: what an operator makes of its axes' values.

    Parameters
    ----------
    lower, upper : (axes, levels, N), values at each axis' lower and upper end

    Returns
    -------
    str
        (corners, levels, N)
    """
    ends = graph.add("Concat", lower, upper, axis=0)
    result = ""
    for axis in range(axis_count):
        rows = [axis + axis_count * (corner >> axis & 1) for corner in range(1 << axis_count)]
        values = graph.add("Gather", ends, graph.integers(rows), axis=0)
        result = graph.add(op_type, result, values) if result else values
    return result


def _weighed(graph: GraphBuilder, table: str, entries: str, fraction: str, axis_count: int) -> str:
    """Features between corners: (N, levels, features), of entries (corners, levels, N) in the table."""
    rest = graph.add("Sub", graph.floats(1.0), fraction)
    shares = _corner_products(graph, "Mul", rest, fraction, axis_count)
    features = graph.add("Gather", table, entries, axis=0)
    features = graph.add("Mul", features, graph.add("Unsqueeze", shares, graph.integers([3])))
    features = graph.add("ReduceSum", features, graph.integers([0]), keepdims=0)
    return graph.add("Transpose", features, perm=(1, 0, 2))


def _dense_entries(graph: GraphBuilder, cell: str, strides: np.ndarray, first: np.ndarray) -> str:
    """Entries (corners, levels, N) of grids whose points have one each; strides int64 (axes, levels)."""
    axis_count, level_count = strides.shape
    base = graph.add("Mul", graph.add("Cast", cell, to=7), graph.integers(strides[:, :, None]))
    base = graph.add("ReduceSum", base, graph.integers([0]), keepdims=1)
    corners = np.array([[corner >> axis & 1 for axis in range(axis_count)] for corner in range(1 << axis_count)])
    return graph.add("Add", base, graph.integers((corners @ strides + first)[:, :, None]))


def _hashed_entries(graph: GraphBuilder, cell: str, axis_count: int, first: np.ndarray, mask: np.ndarray) -> str:
    """Entries (corners, levels, N) of grids whose points share entries: `encoding.corner_entry`."""
    primes = np.array(_PRIMES[:axis_count], np.int64)[:, None, None]
    lower = graph.add("Mul", graph.add("Cast", cell, to=7), graph.integers(primes))
    upper = graph.add("Add", lower, graph.integers(primes))
    mixed = _corner_products(graph, "BitwiseXor", lower, upper, axis_count)
    shared = graph.add("BitwiseAnd", mixed, graph.integers(mask[:, None]))
    return graph.add("Add", shared, graph.integers(first[:, None]))


def grids(
    graph: GraphBuilder, coordinates: Sequence[str], level: Int64Array, table: str, feature_count: int,
    *, is_smooth: bool = False,
) -> str:
    """Features of grids, one row of coordinates (k, N) after the other: (N, levels * features).

    Parameters
    ----------
    coordinates : names of values (k, N) in [0, 1], of all axes together
    level : int64 (levels, LEVEL_FIELDS), `grids.grid_levels`
    """
    axes = coordinates[0] if len(coordinates) == 1 else graph.add("Concat", *coordinates, axis=0)
    axes = graph.add("Unsqueeze", axes, graph.integers([1]))
    axis_count = 3 if len(coordinates) == 1 else 4
    parts = []
    is_hashed = level[:, LEVEL_HASH_MASK] != 0
    for hashed, chosen in ((False, level[~is_hashed]), (True, level[is_hashed])):
        if not len(chosen):
            continue
        resolutions, first = chosen[:, LEVEL_RESOLUTION], chosen[:, LEVEL_FIRST]
        cell, fraction = _cells(graph, axes, resolutions, is_smooth=is_smooth)
        if hashed:
            entries = _hashed_entries(graph, cell, axis_count, first, chosen[:, LEVEL_HASH_MASK])
        else:
            strides = (resolutions + 1) ** np.arange(axis_count)[:, None]
            entries = _dense_entries(graph, cell, strides, first)
        parts.append(_weighed(graph, table, entries, fraction, axis_count))
    # Grids grow ever finer: those that are hashed come last, as their features do.
    features = parts[0] if len(parts) == 1 else graph.add("Concat", *parts, axis=1)
    return graph.reshape(features, (0, len(level) * feature_count))


def planes(
    graph: GraphBuilder, position: str, u: str, level: Int64Array, table: str, feature_count: int,
    *, is_smooth: bool = False,
) -> str:
    """Features of planes over a coordinate and u: (N, levels * 3 * features), `grids.write_planes`.

    Parameters
    ----------
    position : (3, N) in the unit cube; u : (1, N) in [0, 1]
    """
    # A plane is a level of its own, whose first axis is the plane's coordinate and whose second one is u.
    resolutions = np.repeat(level[:, LEVEL_RESOLUTION], PLANES)
    plane = np.tile(np.arange(PLANES), len(level))
    first = np.repeat(level[:, LEVEL_FIRST], PLANES) + plane * (resolutions + 1) ** 2
    along = graph.add("Gather", position, graph.integers(plane), axis=0)
    across = graph.add("Expand", u, graph.add("Shape", along))
    both = [graph.add("Unsqueeze", value, graph.integers([0])) for value in (along, across)]
    cell, fraction = _cells(graph, graph.add("Concat", *both, axis=0), resolutions, is_smooth=is_smooth)
    entries = _dense_entries(graph, cell, (resolutions + 1) ** np.arange(2)[:, None], first)
    return graph.reshape(_weighed(graph, table, entries, fraction, 2), (0, len(plane) * feature_count))


def harmonics(graph: GraphBuilder, direction: str, degree: int) -> str:
    """Real spherical harmonics (N, degree^2) of unit vectors (N, 3), all bands below a degree."""
    terms = _HARMONICS[: degree * degree]
    powers = [p for p in product(range(degree), repeat=3) if any(p == t[1:] for row in terms for t in row)]
    factors = np.zeros((len(powers), len(terms)), np.float32)
    for column, row in enumerate(terms):
        for weight, *power in row:
            factors[powers.index(tuple(power)), column] = weight
    # x^a y^b z^c of all terms: columns of x, y and z, picked again and again, and of ones.
    ones = graph.add("Mul", graph.add("Gather", direction, graph.integers([0]), axis=1), graph.floats(0.0))
    ones = graph.add("Add", ones, graph.floats(1.0))
    columns = graph.add("Concat", direction, ones, axis=1)
    spelled = [[axis for axis in range(3) for _ in range(power[axis])] for power in powers]
    value = ""
    for place in range(max(degree - 1, 1)):
        picked = [axes[place] if place < len(axes) else 3 for axes in spelled]
        factor = graph.add("Gather", columns, graph.integers(picked), axis=1)
        value = graph.add("Mul", value, factor) if value else factor
    return graph.add("MatMul", value, graph.floats(factors))


def layers(graph: GraphBuilder, value: str, weights: Sequence[str]) -> str:
    """A perceptron without bias: ReLU behind all layers but the last. Weights are (inputs, outputs)."""
    for index, name in enumerate(weights):
        value = graph.add("MatMul", value, name)
        if index + 1 < len(weights):
            value = graph.add("Relu", value)
    return value
