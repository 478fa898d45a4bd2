# SPDX-License-Identifier: GPL-3.0-or-later
"""How the radiance network sees positions, directions and u: one definition for training and for inference.

A position is contracted into the unit cube (the bounds take the middle 90% of each axis, the rest of space the ends)
and read from a hash grid by trilinear interpolation. Each coordinate of a direction spreads over three bins in a row by
a smooth kernel; the others are zero, so the first layer needs nine of its rows for a direction, not all of them. What
else light may depend on, u in [0, 1] (`settings.U_DIMENSIONS`), is read with the position from planes (`grids`), spread
over frequencies, or not seen at all.

References
----------
Müller et al. 2022, "Instant Neural Graphics Primitives", Eqs. 2-4 (resolutions and hash).
Müller et al. 2019, "Neural Importance Sampling", section 4.3 (one-blob encoding). The kernel is a triangle of one bin's
half width rather than a Gaussian: its integral over a bin is a quadratic, and zero in all bins but three.
Mildenhall et al. 2020, "NeRF", Eq. 4 (frequencies of u). Dong et al. 2024, "Efficient Neural Path Guiding with 4D
Modeling", section 4.1 (planes).
"""

from __future__ import annotations

import numpy as np

from engine.array_types import Float32Array, Int64Array
from engine.guiding.neural.networks.grids import (
    LEVEL_FIRST,
    LEVEL_HASH_MASK,
    LEVEL_RESOLUTION,
    add_plane_gradient,
    cell_of,
    grid_levels,
    interpolate,
    write_planes,
)
from engine.guiding.neural.networks.radiance import INNER_EXTENT, NetworkShape
from engine.runtime.bundle import Bundle
from engine.runtime.jit import kernel

#: Primes that a grid's coordinates are hashed with.
HASH_Y = np.int64(2654435761)
HASH_Z = np.int64(805459861)
_INNER = np.float32(INNER_EXTENT)
_OUTER = np.float32(1.0 - INNER_EXTENT)


class Encoding(Bundle):
    """What the kernels below read.

    level : int64 (levels, LEVEL_FIELDS), of the hash grid (`grids`)
    center, inverse_extent : float32 (3,), of the bounds: middle [m] and 2 / extent [m^-1]
    table : float32 (entries, features), the hash grid
    position_weights : float32 (levels * features, width), the first layer's rows for the position
    direction_weights : float32 (3 * bins, width), its rows for the direction
    plane_level : int64 (levels, LEVEL_FIELDS), of the planes over a coordinate and u
    planes : float32 (entries, features), all of them
    u_frequencies : int64 (1,), octaves of u
    u_weights : float32 (u_width, width), the first layer's rows for the planes and then the octaves; none where u is
        not seen
    """

    level: Int64Array
    center: Float32Array
    inverse_extent: Float32Array
    table: Float32Array
    position_weights: Float32Array
    direction_weights: Float32Array
    plane_level: Int64Array
    planes: Float32Array
    u_frequencies: Int64Array
    u_weights: Float32Array


def center_and_scale(bounds: Float32Array) -> tuple[Float32Array, Float32Array]:
    """Middle [m] and 2 / extent [m^-1] of bounds float32 (2, 3) [m], as `contract` takes them: float32 (3,) each."""
    lower, upper = bounds.astype(np.float64)
    return (0.5 * (lower + upper)).astype(np.float32), (2.0 / (upper - lower)).astype(np.float32)


def make_encoding(shape: NetworkShape, bounds: Float32Array, parameters: Float32Array) -> Encoding:
    """`Encoding` over views of `parameters`: what training writes there, the kernels see.

    Parameters
    ----------
    bounds : float32 (2, 3) [m]
    parameters : float32 (parameter_count,)
    """
    arrays = shape.split(parameters)
    planes = np.zeros((0, shape.plane_features), np.float32)
    u_weights = np.zeros((0, shape.width), np.float32)
    return Encoding(
        grid_levels(shape.resolutions, shape.level_offsets, shape.table_size),
        *center_and_scale(bounds),
        arrays["table"],
        arrays["position_weights"],
        arrays["direction_weights"],
        grid_levels(shape.plane_resolutions, shape.plane_offsets),
        arrays.get("planes", planes),
        np.array([shape.u_frequencies], np.int64),
        arrays.get("u_weights", u_weights),
    )


@kernel
def contract(x, center, inverse_extent):
    """Coordinate in [0, 1] of a world coordinate; strictly monotonic, never NaN.

    The bounds map linearly to the middle `INNER_EXTENT`, x -> ±infinity to the ends.
    """
    u = (x - center) * inverse_extent
    if u > 1.0:
        u = 1.0 - _OUTER / u
    elif u < -1.0:
        u = -1.0 - _OUTER / u
    else:
        u = _INNER * u
    u = 0.5 + 0.5 * u
    # The comparison is false for NaN.
    return u if (u >= 0.0 and u <= 1.0) else np.float32(0.5)


@kernel
def place(encoding, position, k):
    """Position k of float32 (N, 3) [m] in the unit cube of an encoding's bounds."""
    return (
        contract(position[k, 0], encoding.center[0], encoding.inverse_extent[0]),
        contract(position[k, 1], encoding.center[1], encoding.inverse_extent[1]),
        contract(position[k, 2], encoding.center[2], encoding.inverse_extent[2]),
    )


@kernel
def unit(x):
    """A number within [0, 1]; 0 for NaN."""
    return min(max(x, np.float32(0.0)), np.float32(1.0)) if x == x else np.float32(0.0)


@kernel
def write_frequencies(u, count, out, row, column):
    """Sine and cosine of so many octaves of u in [0, 1], from half a period on; returns the next column."""
    angle = np.float32(np.pi) * u
    for j in range(count):
        out[row, column + 2 * j] = np.sin(angle)
        out[row, column + 2 * j + 1] = np.cos(angle)
        angle += angle
    return column + 2 * count


@kernel
def blob(coordinate, bin_count):
    """One-blob encoding of one coordinate of a unit direction.

    Parameters
    ----------
    coordinate : float32 in [-1, 1]
    bin_count : int, at least 3

    Returns
    -------
    first : int, first of three bins in a row; all others are zero
    a, b, c : float32, share of the kernel in each; they sum to one
    """
    # The two outermost bins lie half outside, so that no kernel loses a part: bin_count - 2 steps across.
    x = (0.5 + 0.5 * coordinate) * np.float32(bin_count - 2)
    first = min(max(np.int64(x), 0), bin_count - 3)
    t = x - np.float32(first)
    return first, 0.5 * (1.0 - t) * (1.0 - t), 0.5 + t * (1.0 - t), 0.5 * t * t


@kernel
def corner_entry(level, index, x, y, z):
    """Row of the table for grid point (x, y, z) of a level."""
    mask = level[index, LEVEL_HASH_MASK]
    if mask != 0:
        # Only the low bits of the products count, so that 64-bit ones hash as the paper's 32-bit ones do.
        entry = (x ^ (y * HASH_Y) ^ (z * HASH_Z)) & mask
    else:
        points = level[index, LEVEL_RESOLUTION] + 1
        entry = (z * points + y) * points + x
    return level[index, LEVEL_FIRST] + entry


@kernel
def cell_corners(level, index, ux, uy, uz):
    """Rows of the table for the eight corners of a cell, x fastest, and their trilinear shares.

    All in scalars: whatever lies between two loads and might alias the table would stop LLVM from pairing them.
    """
    x, fx = cell_of(ux, level[index, LEVEL_RESOLUTION])
    y, fy = cell_of(uy, level[index, LEVEL_RESOLUTION])
    z, fz = cell_of(uz, level[index, LEVEL_RESOLUTION])
    gx = 1.0 - fx
    gy = 1.0 - fy
    gz = 1.0 - fz
    gg = gy * gz
    fg = fy * gz
    gf = gy * fz
    ff = fy * fz
    return (
        corner_entry(level, index, x, y, z),
        corner_entry(level, index, x + 1, y, z),
        corner_entry(level, index, x, y + 1, z),
        corner_entry(level, index, x + 1, y + 1, z),
        corner_entry(level, index, x, y, z + 1),
        corner_entry(level, index, x + 1, y, z + 1),
        corner_entry(level, index, x, y + 1, z + 1),
        corner_entry(level, index, x + 1, y + 1, z + 1),
    ), (gx * gg, fx * gg, gx * fg, fx * fg, gx * gf, fx * gf, gx * ff, fx * ff)


@kernel
def accumulate_latent(encoding, p, out, out_row):
    """Sum of the first layer's rows for position p [m], into `out[out_row]`."""
    ux = contract(p[0], encoding.center[0], encoding.inverse_extent[0])
    uy = contract(p[1], encoding.center[1], encoding.inverse_extent[1])
    uz = contract(p[2], encoding.center[2], encoding.inverse_extent[2])
    level = encoding.level
    table = encoding.table
    weights = encoding.position_weights
    feature_count = table.shape[1]
    width = weights.shape[1]
    for j in range(width):
        out[out_row, j] = 0.0
    for index in range(level.shape[0]):
        entries, shares = cell_corners(level, index, ux, uy, uz)
        for f in range(0, feature_count, 2):
            a = interpolate(table, entries, shares, f)
            b = interpolate(table, entries, shares, f + 1)
            row = index * feature_count + f
            for j in range(width):
                out[out_row, j] += a * weights[row, j] + b * weights[row + 1, j]


@kernel
def _write_u(encoding, ux, uy, uz, u, out, row):
    """Features of u at a position in the unit cube: planes, then frequencies."""
    column = write_planes(encoding.plane_level, encoding.planes, 0, ux, uy, uz, u, out, row, 0)
    write_frequencies(u, encoding.u_frequencies[0], out, row, column)


@kernel
def accumulate_u(encoding, positions, k, u, out, out_row):
    """Add the first layer's rows for u at position k [m] to `out[out_row]`; the row after it is for work."""
    weights = encoding.u_weights
    ux, uy, uz = place(encoding, positions, k)
    _write_u(encoding, ux, uy, uz, unit(u), out, out_row + 1)
    for row in range(weights.shape[0]):
        a = out[out_row + 1, row]
        for j in range(weights.shape[1]):
            out[out_row, j] += a * weights[row, j]


@kernel
def activate(encoding, wi, latent, latent_row, out, out_row):
    """First layer's activations for unit direction wi and a position's `latent[latent_row]`, into `out[out_row]`."""
    weights = encoding.direction_weights
    width = weights.shape[1]
    bin_count = weights.shape[0] // 3
    bx, x0, x1, x2 = blob(wi[0], bin_count)
    by, y0, y1, y2 = blob(wi[1], bin_count)
    bz, z0, z1, z2 = blob(wi[2], bin_count)
    by += bin_count
    bz += 2 * bin_count
    for j in range(width):
        x = x0 * weights[bx, j] + x1 * weights[bx + 1, j] + x2 * weights[bx + 2, j]
        y = y0 * weights[by, j] + y1 * weights[by + 1, j] + y2 * weights[by + 2, j]
        z = z0 * weights[bz, j] + z1 * weights[bz + 1, j] + z2 * weights[bz + 2, j]
        out[out_row, j] = max(latent[latent_row, j] + x + y + z, 0.0)


@kernel
def encode_positions(encoding, positions, start, stop, out):
    """Features of positions, for training.

    Parameters
    ----------
    positions : float32 (N, 3) [m]
    start, stop : int, rows to do
    out : float32 (N, levels * features), written
    """
    level = encoding.level
    table = encoding.table
    feature_count = table.shape[1]
    # Level by level: one level of the table may fit into a cache that all of them do not.
    for index in range(level.shape[0]):
        column = index * feature_count
        for k in range(start, stop):
            ux, uy, uz = place(encoding, positions, k)
            entries, shares = cell_corners(level, index, ux, uy, uz)
            for f in range(0, feature_count, 2):
                a = interpolate(table, entries, shares, f)
                b = interpolate(table, entries, shares, f + 1)
                out[k, column + f] = a
                out[k, column + f + 1] = b


@kernel
def encode_directions(directions, bin_count, start, stop, out):
    """One-blob features of unit directions float32 (N, 3), for training; `out` is float32 (N, 3 * bin_count)."""
    for k in range(start, stop):
        for j in range(3 * bin_count):
            out[k, j] = 0.0
        for axis in range(3):
            first, a, b, c = blob(directions[k, axis], bin_count)
            column = axis * bin_count + first
            out[k, column] = a
            out[k, column + 1] = b
            out[k, column + 2] = c


@kernel
def encode_u(encoding, positions, u, start, stop, out):
    """Features of u float32 (N,) in [0, 1] at positions float32 (N, 3) [m], for training.

    Parameters
    ----------
    start, stop : int, rows to do
    out : float32 (N, u_width), written
    """
    for k in range(start, stop):
        ux, uy, uz = place(encoding, positions, k)
        _write_u(encoding, ux, uy, uz, unit(u[k]), out, k)


@kernel
def backpropagate_u(encoding, positions, u, row_count, feature_gradient, first_column, first_level, last_level, out):
    """As `backpropagate_positions`, of `encode_u` and the planes; u : float32 (N,) in [0, 1]."""
    for index in range(first_level, last_level):
        for k in range(row_count):
            ux, uy, uz = place(encoding, positions, k)
            add_plane_gradient(
                encoding.plane_level, index, 0, ux, uy, uz, unit(u[k]), feature_gradient, k, first_column, out
            )


@kernel
def backpropagate_positions(
    encoding, positions, u, row_count, feature_gradient, first_column, first_level, last_level, out
):
    """Add the gradient of `encode_positions` to that of the hash grid.

    Rows are taken in order, and levels share no entries: the result is the same however levels are dealt to threads.

    Parameters
    ----------
    u : float32 (N,), not read
    feature_gradient : float32 (at least row_count, features)
    first_column : int, of the features that come from this table
    first_level, last_level : int, levels to do, the last one excluded
    out : float32 (entries, features), added to
    """
    level = encoding.level
    feature_count = out.shape[1]
    for index in range(first_level, last_level):
        column = first_column + index * feature_count
        for k in range(row_count):
            ux, uy, uz = place(encoding, positions, k)
            entries, shares = cell_corners(level, index, ux, uy, uz)
            for corner in range(8):
                for f in range(feature_count):
                    out[entries[corner], f] += shares[corner] * feature_gradient[k, column + f]
