# SPDX-License-Identifier: GPL-3.0-or-later
"""What a mixture network sees of a point: one definition, which training and inference both run.

Positions are contracted into the unit cube (`encoding.contract`: the bounds take the middle 90% of each axis, the rest
of space the ends) and either read from dense grids of learned features or spread over bins. A further dimension u in
[0, 1], the time of the shutter, is read with the position from three planes (x, u), (y, u), (z, u) or from grids over
(x, y, z, u), or spread over frequencies. Features are, in order: those of the position, the planes, the grids over
(x, y, z, u), the normal, the direction to the viewer, the roughness and u, and ones up to a multiple of eight.

References
----------
Dong et al. 2023, Eq. 13 (grids). Huang et al. 2024, Table 1 (one-blob, raw directions, ones as a bias).
Müller et al. 2022, "Instant Neural Graphics Primitives", appendix A (smoothstep between grid points).
Müller et al. 2019, "Neural Importance Sampling", section 4.3 (one-blob); its kernel here is `encoding.blob`.
Sloan 2013, "Efficient Spherical Harmonic Evaluation" (bands 0 to 3).
Mildenhall et al. 2020, "NeRF", Eq. 4 (frequencies of u).
Dong et al. 2024, "Efficient Neural Path Guiding with 4D Modeling", Eqs. 7 and 8 (planes), section 6.2 (4D grids).
Müller et al. 2022, Eq. 4 (hash); its primes, and for the fourth dimension that of their program.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from engine.array_types import Float32Array, Int64Array
from engine.guiding.neural.networks.encoding import (
    HASH_Y,
    HASH_Z,
    blob,
    center_and_scale,
    place,
    unit,
    write_frequencies,
)
from engine.guiding.neural.networks.grids import (
    LEVEL_FIRST,
    LEVEL_HASH_MASK,
    LEVEL_RESOLUTION,
    add_plane_gradient,
    grid_levels,
    interpolate,
    smooth_cell,
    write_planes,
)
from engine.guiding.neural.networks.mixture.shape import TABLES, MixtureShape
from engine.runtime.bundle import Bundle
from engine.runtime.jit import kernel

#: Prime that the fourth coordinate of a grid is hashed with.
HASH_U = np.int64(3674653429)

# Entries of MixtureEncoding.options
OPTION_IS_SMOOTH = 0
OPTION_POSITION_BINS = 1  # 0 = grids, or none
OPTION_NORMAL = 2  # ENCODING_*
OPTION_NORMAL_SIZE = 3
OPTION_WO = 4
OPTION_WO_SIZE = 5
OPTION_ROUGHNESS_BINS = 6
OPTION_U_FREQUENCIES = 7
OPTION_FEATURE_WIDTH = 8
OPTION_COUNT = 9

ENCODING_NONE = 0
ENCODING_RAW = 1
ENCODING_BLOB = 2
ENCODING_HARMONICS = 3
_ENCODINGS = {"NONE": ENCODING_NONE, "RAW": ENCODING_RAW, "BLOB": ENCODING_BLOB, "HARMONICS": ENCODING_HARMONICS}


class MixtureEncoding(Bundle):
    """What the kernels below read.

    level, plane_level, hash_level : int64 (levels, LEVEL_FIELDS), of each grid the cells along an axis, the first
        entry in its table, and what a hash is cut with
    options : int64 (OPTION_COUNT,), OPTION_*
    center, inverse_extent : float32 (3,), of the bounds: middle [m] and 2 / extent [m^-1]
    table, planes, hashes : float32 (entries, features), all grids of the position, all planes, all grids over (x, u)
    """

    level: Int64Array
    plane_level: Int64Array
    hash_level: Int64Array
    options: Int64Array
    center: Float32Array
    inverse_extent: Float32Array
    table: Float32Array
    planes: Float32Array
    hashes: Float32Array


def make_mixture_encoding(
    shape: MixtureShape, bounds: Float32Array, arrays: Mapping[str, Float32Array]
) -> MixtureEncoding:
    """`MixtureEncoding` over views of tables: what training writes there, the kernels see.

    Parameters
    ----------
    bounds : float32 (2, 3) [m]
    arrays : mapping
        Those of `shape.layout`, as far as they are `TABLES`.
    """
    features = shape.level_features, shape.plane_features, shape.hash_features
    tables = [
        arrays.get(name, np.zeros((1, count), np.float32)) for name, count in zip(TABLES, features, strict=True)
    ]
    options = np.zeros(OPTION_COUNT, np.int64)
    options[OPTION_IS_SMOOTH] = shape.interpolation == "SMOOTH"
    options[OPTION_POSITION_BINS] = shape.position_bins if shape.position_encoding == "BLOB" else 0
    options[OPTION_NORMAL] = _ENCODINGS[shape.normal_encoding]
    options[OPTION_NORMAL_SIZE] = shape.normal_size
    options[OPTION_WO] = _ENCODINGS[shape.wo_encoding]
    options[OPTION_WO_SIZE] = shape.wo_size
    options[OPTION_ROUGHNESS_BINS] = shape.roughness_bins
    options[OPTION_U_FREQUENCIES] = shape.u_frequencies
    options[OPTION_FEATURE_WIDTH] = shape.feature_width
    return MixtureEncoding(
        grid_levels(shape.resolutions, shape.level_offsets),
        grid_levels(shape.plane_resolutions, shape.plane_offsets),
        grid_levels(shape.hash_resolutions, shape.hash_offsets, shape.hash_size, 4),
        options, *center_and_scale(bounds), *tables,
    )


@kernel
def _smooth_cell(encoding, c, resolution):
    """Cell along an axis of `c` in [0, 1], and how far within it."""
    return smooth_cell(c, resolution, encoding.options[OPTION_IS_SMOOTH])


@kernel
def _trilinear_shares(fx, fy, fz):
    """Shares of the eight corners of a cell, x fastest."""
    gx = 1.0 - fx
    gy = 1.0 - fy
    gz = 1.0 - fz
    return (
        gx * gy * gz, fx * gy * gz, gx * fy * gz, fx * fy * gz, gx * gy * fz, fx * gy * fz, gx * fy * fz, fx * fy * fz,
    )  # fmt: skip


@kernel
def _corners(encoding, index, ux, uy, uz):
    """Rows of the table for the eight corners of a cell, x fastest, and their shares."""
    resolution = encoding.level[index, LEVEL_RESOLUTION]
    x, fx = _smooth_cell(encoding, ux, resolution)
    y, fy = _smooth_cell(encoding, uy, resolution)
    z, fz = _smooth_cell(encoding, uz, resolution)
    row = resolution + 1
    slab = row * row
    e = encoding.level[index, LEVEL_FIRST] + z * slab + y * row + x
    return (
        e, e + 1, e + row, e + row + 1, e + slab, e + slab + 1, e + slab + row, e + slab + row + 1,
    ), _trilinear_shares(fx, fy, fz)  # fmt: skip


@kernel
def _write_grids(encoding, ux, uy, uz, out, row):
    """Interpolated features of a position in the unit cube."""
    table = encoding.table
    feature_count = table.shape[1]
    for index in range(encoding.level.shape[0]):
        entries, shares = _corners(encoding, index, ux, uy, uz)
        for f in range(0, feature_count, 4):
            # All loads before the first store, which might alias them: LLVM then makes vectors of four.
            a = interpolate(table, entries, shares, f)
            b = interpolate(table, entries, shares, f + 1)
            c = interpolate(table, entries, shares, f + 2)
            d = interpolate(table, entries, shares, f + 3)
            column = index * feature_count + f
            out[row, column] = a
            out[row, column + 1] = b
            out[row, column + 2] = c
            out[row, column + 3] = d
    return encoding.level.shape[0] * feature_count


@kernel
def _hash_entry(encoding, index, x, y, z, w):
    """Row of the table for a point of a four-dimensional grid."""
    mask = encoding.hash_level[index, LEVEL_HASH_MASK]
    if mask != 0:
        # Only the low bits of the products count, so that 64-bit ones hash as 32-bit ones do.
        entry = (x ^ (y * HASH_Y) ^ (z * HASH_Z) ^ (w * HASH_U)) & mask
    else:
        row = encoding.hash_level[index, LEVEL_RESOLUTION] + 1
        entry = ((w * row + z) * row + y) * row + x
    return encoding.hash_level[index, LEVEL_FIRST] + entry


@kernel
def _hash_corners(encoding, index, ux, uy, uz, u):
    """Rows of the table for the eight corners of a cell at the lower u and at the upper u, x fastest, their shares
    among the eight, and the share of the upper u.
    """
    resolution = encoding.hash_level[index, LEVEL_RESOLUTION]
    x, fx = _smooth_cell(encoding, ux, resolution)
    y, fy = _smooth_cell(encoding, uy, resolution)
    z, fz = _smooth_cell(encoding, uz, resolution)
    w, fw = _smooth_cell(encoding, u, resolution)
    return (
        (
            _hash_entry(encoding, index, x, y, z, w), _hash_entry(encoding, index, x + 1, y, z, w),
            _hash_entry(encoding, index, x, y + 1, z, w), _hash_entry(encoding, index, x + 1, y + 1, z, w),
            _hash_entry(encoding, index, x, y, z + 1, w), _hash_entry(encoding, index, x + 1, y, z + 1, w),
            _hash_entry(encoding, index, x, y + 1, z + 1, w), _hash_entry(encoding, index, x + 1, y + 1, z + 1, w),
        ),
        (
            _hash_entry(encoding, index, x, y, z, w + 1), _hash_entry(encoding, index, x + 1, y, z, w + 1),
            _hash_entry(encoding, index, x, y + 1, z, w + 1), _hash_entry(encoding, index, x + 1, y + 1, z, w + 1),
            _hash_entry(encoding, index, x, y, z + 1, w + 1), _hash_entry(encoding, index, x + 1, y, z + 1, w + 1),
            _hash_entry(encoding, index, x, y + 1, z + 1, w + 1),
            _hash_entry(encoding, index, x + 1, y + 1, z + 1, w + 1),
        ),
        _trilinear_shares(fx, fy, fz),
        fw,
    )  # fmt: skip


@kernel
def _write_hashes(encoding, ux, uy, uz, u, out, row, column):
    """Interpolated features of the four-dimensional grids; returns the next column."""
    hashes = encoding.hashes
    feature_count = hashes.shape[1]
    for index in range(encoding.hash_level.shape[0]):
        lower, upper, shares, late = _hash_corners(encoding, index, ux, uy, uz, u)
        for f in range(feature_count):
            before = interpolate(hashes, lower, shares, f)
            out[row, column + f] = before + late * (interpolate(hashes, upper, shares, f) - before)
        column += feature_count
    return column


@kernel
def _write_blob(coordinate, bin_count, out, row, column):
    """One-blob features of a coordinate in [-1, 1]; returns the next column."""
    for j in range(bin_count):
        out[row, column + j] = 0.0
    first, a, b, c = blob(coordinate, bin_count)
    out[row, column + first] = a
    out[row, column + first + 1] = b
    out[row, column + first + 2] = c
    return column + bin_count


@kernel
def _component(x):
    """Coordinate of a unit vector within [-1, 1]; 0 for NaN."""
    return min(max(x, np.float32(-1.0)), np.float32(1.0)) if x == x else np.float32(0.0)


@kernel
def _write_harmonics(x, y, z, degree, out, row, column):
    """Real spherical harmonics of all bands below `degree`; returns the next column."""
    out[row, column] = 0.28209479
    if degree > 1:
        out[row, column + 1] = -0.48860251 * y
        out[row, column + 2] = 0.48860251 * z
        out[row, column + 3] = -0.48860251 * x
    if degree > 2:
        out[row, column + 4] = 1.09254843 * x * y
        out[row, column + 5] = -1.09254843 * y * z
        out[row, column + 6] = 0.94617470 * z * z - 0.31539157
        out[row, column + 7] = -1.09254843 * x * z
        out[row, column + 8] = 0.54627422 * (x * x - y * y)
    if degree > 3:
        out[row, column + 9] = -0.59004359 * y * (3.0 * x * x - y * y)
        out[row, column + 10] = 2.89061144 * x * y * z
        out[row, column + 11] = -0.45704580 * y * (5.0 * z * z - 1.0)
        out[row, column + 12] = 0.37317633 * z * (5.0 * z * z - 3.0)
        out[row, column + 13] = -0.45704580 * x * (5.0 * z * z - 1.0)
        out[row, column + 14] = 1.44530572 * z * (x * x - y * y)
        out[row, column + 15] = -0.59004359 * x * (x * x - 3.0 * y * y)
    return column + degree * degree


@kernel
def _write_direction(x, y, z, encoding_kind, size, out, row, column):
    """Features of a unit vector; returns the next column."""
    x = _component(x)
    y = _component(y)
    z = _component(z)
    if encoding_kind == ENCODING_RAW:
        out[row, column] = x
        out[row, column + 1] = y
        out[row, column + 2] = z
        return column + 3
    if encoding_kind == ENCODING_BLOB:
        column = _write_blob(x, size, out, row, column)
        column = _write_blob(y, size, out, row, column)
        return _write_blob(z, size, out, row, column)
    if encoding_kind == ENCODING_HARMONICS:
        return _write_harmonics(x, y, z, size, out, row, column)
    return column


@kernel
def encode_features(encoding, position, normal, wo, roughness, u, start, stop, out):
    """Features of points `start` to `stop`, into the first rows of `out`. Whatever goes in, they are finite.

    Parameters
    ----------
    encoding : MixtureEncoding
    position : float32 (N, 3) [m]
    normal : float32 (N, 3), unit shading normal on the viewer's side
    wo : float32 (N, 3), unit, towards the viewer
    roughness : float32 (N,), in [0, 1]
    u : float32 (N,), the further dimension, in [0, 1]
    start, stop : int, points to do
    out : float32 (at least stop - start, at least feature_width), written
    """
    options = encoding.options
    position_bins = options[OPTION_POSITION_BINS]
    roughness_bins = options[OPTION_ROUGHNESS_BINS]
    for k in range(start, stop):
        row = k - start
        ux, uy, uz = place(encoding, position, k)
        uw = unit(u[k])
        if position_bins == 0:
            column = _write_grids(encoding, ux, uy, uz, out, row)
        else:
            column = _write_blob(2.0 * ux - 1.0, position_bins, out, row, np.int64(0))
            column = _write_blob(2.0 * uy - 1.0, position_bins, out, row, column)
            column = _write_blob(2.0 * uz - 1.0, position_bins, out, row, column)
        column = write_planes(
            encoding.plane_level, encoding.planes, options[OPTION_IS_SMOOTH], ux, uy, uz, uw, out, row, column
        )
        column = _write_hashes(encoding, ux, uy, uz, uw, out, row, column)
        column = _write_direction(
            normal[k, 0], normal[k, 1], normal[k, 2], options[OPTION_NORMAL], options[OPTION_NORMAL_SIZE], out, row,
            column,
        )
        column = _write_direction(
            wo[k, 0], wo[k, 1], wo[k, 2], options[OPTION_WO], options[OPTION_WO_SIZE], out, row, column
        )
        if roughness_bins != 0:
            # Rough surfaces differ less than smooth ones do.
            seen = 1.0 - np.exp(-unit(roughness[k]))
            column = _write_blob(2.0 * seen - 1.0, roughness_bins, out, row, column)
        column = write_frequencies(uw, options[OPTION_U_FREQUENCIES], out, row, column)
        for j in range(column, options[OPTION_FEATURE_WIDTH]):
            out[row, j] = 1.0


@kernel
def backpropagate_grids(encoding, position, u, row_count, feature_gradient, first_column, first_level, last_level, out):
    """Add the gradient of `encode_features` to that of the grids of the position.

    Rows are taken in order, and levels share no entries: the result is the same however levels are dealt to threads.

    Parameters
    ----------
    u : float32 (N,), not read
    feature_gradient : float32 (at least row_count, features)
    first_column : int, of the features that come from this table
    first_level, last_level : int, levels to do, the last one excluded
    out : float32 (entries, features), added to
    """
    feature_count = out.shape[1]
    for index in range(first_level, last_level):
        column = first_column + index * feature_count
        for k in range(row_count):
            ux, uy, uz = place(encoding, position, k)
            entries, shares = _corners(encoding, index, ux, uy, uz)
            for corner in range(8):
                for f in range(feature_count):
                    out[entries[corner], f] += shares[corner] * feature_gradient[k, column + f]


@kernel
def backpropagate_planes(
    encoding, position, u, row_count, feature_gradient, first_column, first_level, last_level, out
):
    """As `backpropagate_grids`, of the planes; u : float32 (N,) in [0, 1]."""
    for index in range(first_level, last_level):
        for k in range(row_count):
            ux, uy, uz = place(encoding, position, k)
            add_plane_gradient(
                encoding.plane_level, index, encoding.options[OPTION_IS_SMOOTH], ux, uy, uz, unit(u[k]),
                feature_gradient, k, first_column, out,
            )


@kernel
def backpropagate_hashes(
    encoding, position, u, row_count, feature_gradient, first_column, first_level, last_level, out
):
    """As `backpropagate_grids`, of the four-dimensional grids; u : float32 (N,) in [0, 1]."""
    feature_count = out.shape[1]
    for index in range(first_level, last_level):
        column = first_column + index * feature_count
        for k in range(row_count):
            ux, uy, uz = place(encoding, position, k)
            lower, upper, shares, late = _hash_corners(encoding, index, ux, uy, uz, unit(u[k]))
            for corner in range(8):
                for f in range(feature_count):
                    gradient = shares[corner] * feature_gradient[k, column + f]
                    out[lower[corner], f] += (1.0 - late) * gradient
                    out[upper[corner], f] += late * gradient
