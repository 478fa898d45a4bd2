# SPDX-License-Identifier: GPL-3.0-or-later
"""What a mixture network sees of a point: one definition, which training and inference both run.

Positions are contracted into the unit cube (`encoding.contract`: the bounds take the middle 90% of each axis, the rest
of space the ends) and either read from dense grids of learned features or spread over bins. Features are, in order:
those of the position, the normal, the direction to the viewer, the roughness and the time, and ones up to a multiple of
eight.

References
----------
Dong et al. 2023, Eq. 13 (grids). Huang et al. 2024, Table 1 (one-blob, raw directions, ones as a bias).
Müller et al. 2022, "Instant Neural Graphics Primitives", appendix A (smoothstep between grid points).
Müller et al. 2019, "Neural Importance Sampling", section 4.3 (one-blob); its kernel here is `encoding.blob`.
Sloan 2013, "Efficient Spherical Harmonic Evaluation" (bands 0 to 3).
Mildenhall et al. 2020, "NeRF", Eq. 4 (frequencies of the time).
"""

from __future__ import annotations

import numpy as np

from engine.bundle import Bundle
from engine.guiding.encoding import blob, cell_of, contract
from engine.guiding.mixture.shape import MixtureShape
from engine.jit import kernel
from engine.scene.arrays import Float32Array, Int64Array

# Columns of MixtureEncoding.level
LEVEL_RESOLUTION = 0
LEVEL_FIRST = 1
LEVEL_FIELDS = 2

# Entries of MixtureEncoding.options
OPTION_IS_SMOOTH = 0
OPTION_POSITION_BINS = 1  # 0 = grids
OPTION_NORMAL = 2  # ENCODING_*
OPTION_NORMAL_SIZE = 3
OPTION_WO = 4
OPTION_WO_SIZE = 5
OPTION_ROUGHNESS_BINS = 6
OPTION_TIME_FREQUENCIES = 7
OPTION_FEATURE_WIDTH = 8
OPTION_COUNT = 9

ENCODING_NONE = 0
ENCODING_RAW = 1
ENCODING_BLOB = 2
ENCODING_HARMONICS = 3
_ENCODINGS = {"NONE": ENCODING_NONE, "RAW": ENCODING_RAW, "BLOB": ENCODING_BLOB, "HARMONICS": ENCODING_HARMONICS}


class MixtureEncoding(Bundle):
    """What the kernels below read.

    level : int64 (levels, LEVEL_FIELDS), of each grid the cells along an axis and the first entry in the table
    options : int64 (OPTION_COUNT,), OPTION_*
    center, inverse_extent : float32 (3,), of the bounds: middle [m] and 2 / extent [m^-1]
    table : float32 (entries, features), all grids
    """

    level: Int64Array
    options: Int64Array
    center: Float32Array
    inverse_extent: Float32Array
    table: Float32Array


def make_mixture_encoding(shape: MixtureShape, bounds: Float32Array, table: Float32Array) -> MixtureEncoding:
    """`MixtureEncoding` over a view of `table`: what training writes there, the kernels see.

    Parameters
    ----------
    bounds : float32 (2, 3) [m]
    table : float32 (entries, level_features); of any length where the position is not read from grids
    """
    offsets = shape.level_offsets
    level = np.array([*zip(shape.resolutions, offsets, strict=False)], np.int64).reshape(-1, LEVEL_FIELDS)
    options = np.zeros(OPTION_COUNT, np.int64)
    options[OPTION_IS_SMOOTH] = shape.interpolation == "SMOOTH"
    options[OPTION_POSITION_BINS] = shape.position_bins if shape.position_encoding == "BLOB" else 0
    options[OPTION_NORMAL] = _ENCODINGS[shape.normal_encoding]
    options[OPTION_NORMAL_SIZE] = shape.normal_size
    options[OPTION_WO] = _ENCODINGS[shape.wo_encoding]
    options[OPTION_WO_SIZE] = shape.wo_size
    options[OPTION_ROUGHNESS_BINS] = shape.roughness_bins
    options[OPTION_TIME_FREQUENCIES] = shape.time_frequencies
    options[OPTION_FEATURE_WIDTH] = shape.feature_width
    lower, upper = bounds.astype(np.float64)
    center = (0.5 * (lower + upper)).astype(np.float32)
    return MixtureEncoding(level, options, center, (2.0 / (upper - lower)).astype(np.float32), table)


@kernel
def _fraction(fraction, is_smooth):
    """How far between two grid points a value is: linear, or by smoothstep."""
    return fraction * fraction * (3.0 - 2.0 * fraction) if is_smooth != 0 else fraction


@kernel
def _corners(encoding, index, ux, uy, uz):
    """Rows of the table for the eight corners of a cell, x fastest, and their shares."""
    resolution = encoding.level[index, LEVEL_RESOLUTION]
    is_smooth = encoding.options[OPTION_IS_SMOOTH]
    x, fx = cell_of(ux, resolution)
    y, fy = cell_of(uy, resolution)
    z, fz = cell_of(uz, resolution)
    fx = _fraction(fx, is_smooth)
    fy = _fraction(fy, is_smooth)
    fz = _fraction(fz, is_smooth)
    gx = 1.0 - fx
    gy = 1.0 - fy
    gz = 1.0 - fz
    row = resolution + 1
    slab = row * row
    e = encoding.level[index, LEVEL_FIRST] + z * slab + y * row + x
    return (e, e + 1, e + row, e + row + 1, e + slab, e + slab + 1, e + slab + row, e + slab + row + 1), (
        gx * gy * gz, fx * gy * gz, gx * fy * gz, fx * fy * gz, gx * gy * fz, fx * gy * fz, gx * fy * fz, fx * fy * fz,
    )


@kernel
def _between(table, entries, shares, f):
    """Feature `f` between the eight corners."""
    return (
        (shares[0] * table[entries[0], f] + shares[1] * table[entries[1], f])
        + (shares[2] * table[entries[2], f] + shares[3] * table[entries[3], f])
        + (shares[4] * table[entries[4], f] + shares[5] * table[entries[5], f])
        + (shares[6] * table[entries[6], f] + shares[7] * table[entries[7], f])
    )


@kernel
def _write_grids(encoding, ux, uy, uz, out, row):
    """Interpolated features of a position in the unit cube."""
    table = encoding.table
    feature_count = table.shape[1]
    for index in range(encoding.level.shape[0]):
        entries, shares = _corners(encoding, index, ux, uy, uz)
        for f in range(0, feature_count, 4):
            # All loads before the first store, which might alias them: LLVM then makes vectors of four.
            a = _between(table, entries, shares, f)
            b = _between(table, entries, shares, f + 1)
            c = _between(table, entries, shares, f + 2)
            d = _between(table, entries, shares, f + 3)
            column = index * feature_count + f
            out[row, column] = a
            out[row, column + 1] = b
            out[row, column + 2] = c
            out[row, column + 3] = d
    return encoding.level.shape[0] * feature_count


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
def _write_frequencies(time, count, out, row, column):
    """Sine and cosine of so many octaves of a time in [0, 1], from half a period on; returns the next column."""
    angle = np.float32(np.pi) * min(max(_component(time), np.float32(0.0)), np.float32(1.0))
    for j in range(count):
        out[row, column + 2 * j] = np.sin(angle)
        out[row, column + 2 * j + 1] = np.cos(angle)
        angle += angle
    return column + 2 * count


@kernel
def encode_features(encoding, position, normal, wo, roughness, time, start, stop, out):
    """Features of points `start` to `stop`, into the first rows of `out`. Whatever goes in, they are finite.

    Parameters
    ----------
    encoding : MixtureEncoding
    position : float32 (N, 3) [m]
    normal : float32 (N, 3), unit shading normal on the viewer's side
    wo : float32 (N, 3), unit, towards the viewer
    roughness : float32 (N,), in [0, 1]
    time : float32 (N,), of the shutter, in [0, 1]
    start, stop : int, points to do
    out : float32 (at least stop - start, at least feature_width), written
    """
    options = encoding.options
    position_bins = options[OPTION_POSITION_BINS]
    roughness_bins = options[OPTION_ROUGHNESS_BINS]
    for k in range(start, stop):
        row = k - start
        ux = contract(position[k, 0], encoding.center[0], encoding.inverse_extent[0])
        uy = contract(position[k, 1], encoding.center[1], encoding.inverse_extent[1])
        uz = contract(position[k, 2], encoding.center[2], encoding.inverse_extent[2])
        if position_bins == 0:
            column = _write_grids(encoding, ux, uy, uz, out, row)
        else:
            column = _write_blob(2.0 * ux - 1.0, position_bins, out, row, np.int64(0))
            column = _write_blob(2.0 * uy - 1.0, position_bins, out, row, column)
            column = _write_blob(2.0 * uz - 1.0, position_bins, out, row, column)
        column = _write_direction(
            normal[k, 0], normal[k, 1], normal[k, 2], options[OPTION_NORMAL], options[OPTION_NORMAL_SIZE], out, row,
            column,
        )
        column = _write_direction(
            wo[k, 0], wo[k, 1], wo[k, 2], options[OPTION_WO], options[OPTION_WO_SIZE], out, row, column
        )
        if roughness_bins != 0:
            # Rough surfaces differ less than smooth ones do.
            seen = 1.0 - np.exp(-min(max(_component(roughness[k]), np.float32(0.0)), np.float32(1.0)))
            column = _write_blob(2.0 * seen - 1.0, roughness_bins, out, row, column)
        column = _write_frequencies(time[k], options[OPTION_TIME_FREQUENCIES], out, row, column)
        for j in range(column, options[OPTION_FEATURE_WIDTH]):
            out[row, j] = 1.0


@kernel
def backpropagate_features(encoding, position, row_count, feature_gradient, first_level, last_level, table_gradient):
    """Add the gradient of `encode_features` to that of the grids.

    Rows are taken in order, and levels share no entries: the result is the same however levels are dealt to threads.

    Parameters
    ----------
    feature_gradient : float32 (at least row_count, at least levels * features)
    first_level, last_level : int, levels to do, the last one excluded
    table_gradient : float32 (entries, features), added to
    """
    feature_count = table_gradient.shape[1]
    for index in range(first_level, last_level):
        column = index * feature_count
        for k in range(row_count):
            ux = contract(position[k, 0], encoding.center[0], encoding.inverse_extent[0])
            uy = contract(position[k, 1], encoding.center[1], encoding.inverse_extent[1])
            uz = contract(position[k, 2], encoding.center[2], encoding.inverse_extent[2])
            entries, shares = _corners(encoding, index, ux, uy, uz)
            for corner in range(8):
                for f in range(feature_count):
                    table_gradient[entries[corner], f] += shares[corner] * feature_gradient[k, column + f]


@kernel
def step_grids(table, gradient, moments, variances, average, average_step, decay, step, rate, beta1, beta2, epsilon):
    """One step of Adam for the entries that have a gradient, which is set back to zero; and of the running average.

    Entries without a gradient are left alone, moments included. Their parameters stay as they are, so what the average
    missed is a power of its decay, caught up with at the entry's next step or by `catch_up`.

    Parameters
    ----------
    table, gradient, moments, variances, average : float32 (entries, features)
    average_step : int32 (entries,), step after which an entry's average is up to date
    decay : float32 (D,), the k-th power of the average's decay; beyond the last it counts as zero
    step : int, this step, from 1
    rate : float32, learning rate times the bias corrections sqrt(1 - beta2^t) / (1 - beta1^t)
    beta1, beta2, epsilon : float32, Adam's

    References
    ----------
    Kingma and Ba 2014, Algorithm 1.
    """
    for entry in range(table.shape[0]):
        size = np.float32(0.0)
        for f in range(table.shape[1]):
            size += abs(gradient[entry, f])
        if size > 0.0:
            missed = _power(decay, step - 1 - average_step[entry])
            average_step[entry] = step
            for f in range(table.shape[1]):
                g = gradient[entry, f]
                gradient[entry, f] = 0.0
                m = beta1 * moments[entry, f] + (1.0 - beta1) * g
                v = beta2 * variances[entry, f] + (1.0 - beta2) * g * g
                moments[entry, f] = m
                variances[entry, f] = v
                old = table[entry, f]
                new = old - rate * m / (np.sqrt(v) + epsilon)
                table[entry, f] = new
                mean = old + missed * (average[entry, f] - old)
                average[entry, f] = new + decay[1] * (mean - new)


@kernel
def catch_up(table, average, average_step, decay, step):
    """Bring the running average of every entry to `step`; parameters as in `step_grids`."""
    for entry in range(table.shape[0]):
        missed = _power(decay, step - average_step[entry])
        average_step[entry] = step
        for f in range(table.shape[1]):
            average[entry, f] = table[entry, f] + missed * (average[entry, f] - table[entry, f])


@kernel
def _power(decay, exponent):
    return decay[exponent] if exponent < decay.shape[0] else np.float32(0.0)
