# SPDX-License-Identifier: GPL-3.0-or-later
"""Grids of learned features: read by interpolation, among them planes over a coordinate and u, and stepped by Adam.

Where light depends on more than the position, on the time or the wavelength, that is u in [0, 1]
(`settings.U_DIMENSIONS`).

References
----------
Müller et al. 2022, "Instant Neural Graphics Primitives", appendix A (smoothstep between grid points).
Dong et al. 2024, "Efficient Neural Path Guiding with 4D Modeling", Eqs. 7 and 8 (planes).
"""

from __future__ import annotations

import numpy as np

from engine.array_types import Int64Array
from engine.runtime.jit import kernel

# Columns that say where a grid lies in its table
LEVEL_RESOLUTION = 0
LEVEL_FIRST = 1
LEVEL_HASH_MASK = 2  # 0 = every point has an entry of its own
LEVEL_FIELDS = 3

#: Planes of a level: (x, u), (y, u), (z, u).
PLANES = 3


def grid_levels(
    resolutions: tuple[int, ...], offsets: tuple[int, ...], most: int = 0, dimension_count: int = 3
) -> Int64Array:
    """Where grids lie in their table.

    Parameters
    ----------
    resolutions : cells along an axis of each grid
    offsets : first entry of each
    most : int, entries of a grid at most, a power of two; 0 = as many as there are points
    dimension_count : int, axes of a grid; read with `most` only

    Returns
    -------
    int64 (grids, LEVEL_FIELDS), LEVEL_*
    """
    level = np.zeros((len(resolutions), LEVEL_FIELDS), np.int64)
    for index, resolution in enumerate(resolutions):
        is_hashed = 0 < most < (resolution + 1) ** dimension_count
        level[index] = resolution, offsets[index], most - 1 if is_hashed else 0
    return level


@kernel
def cell_of(u, resolution):
    """Cell along an axis of `u` in [0, 1], and the fraction within it."""
    x = u * np.float32(resolution)
    cell = min(np.int64(x), resolution - 1)
    return cell, x - np.float32(cell)


@kernel
def smooth_cell(c, resolution, is_smooth):
    """Cell along an axis of `c` in [0, 1], and how far within it: linear, or by smoothstep."""
    cell, fraction = cell_of(c, resolution)
    return cell, fraction * fraction * (3.0 - 2.0 * fraction) if is_smooth != 0 else fraction


@kernel
def interpolate(table, entries, shares, f):
    """Feature `f` between the eight corners."""
    return (
        (shares[0] * table[entries[0], f] + shares[1] * table[entries[1], f])
        + (shares[2] * table[entries[2], f] + shares[3] * table[entries[3], f])
        + (shares[4] * table[entries[4], f] + shares[5] * table[entries[5], f])
        + (shares[6] * table[entries[6], f] + shares[7] * table[entries[7], f])
    )


@kernel
def _plane_corners(level, index, plane, c, u, is_smooth):
    """Rows of the planes' table for the four corners of a cell, the coordinate fastest, and their shares (Eq. 7)."""
    resolution = level[index, LEVEL_RESOLUTION]
    x, fx = smooth_cell(c, resolution, is_smooth)
    y, fy = smooth_cell(u, resolution, is_smooth)
    gx = 1.0 - fx
    gy = 1.0 - fy
    row = resolution + 1
    e = level[index, LEVEL_FIRST] + plane * row * row + y * row + x
    return (e, e + 1, e + row, e + row + 1), (gx * gy, fx * gy, gx * fy, fx * fy)


@kernel
def _between_four(table, entries, shares, f):
    """Feature `f` between the four corners."""
    return (shares[0] * table[entries[0], f] + shares[1] * table[entries[1], f]) + (
        shares[2] * table[entries[2], f] + shares[3] * table[entries[3], f]
    )


@kernel
def write_planes(level, planes, is_smooth, ux, uy, uz, u, out, row, column):
    """Interpolated features of the planes, of each level (x, u), (y, u), (z, u).

    Parameters
    ----------
    level : int64 (levels, LEVEL_FIELDS); planes : float32 (entries, features)
    is_smooth : int, not 0: smoothstep between points
    ux, uy, uz, u : float32, position in the unit cube and u, in [0, 1]
    out : float32 (N, columns), written from (row, column) on

    Returns
    -------
    int
        The next column.
    """
    feature_count = planes.shape[1]
    for index in range(level.shape[0]):
        for plane in range(PLANES):
            c = ux if plane == 0 else (uy if plane == 1 else uz)
            entries, shares = _plane_corners(level, index, plane, c, u, is_smooth)
            for f in range(0, feature_count, 2):
                a = _between_four(planes, entries, shares, f)
                b = _between_four(planes, entries, shares, f + 1)
                out[row, column + f] = a
                out[row, column + f + 1] = b
            column += feature_count
    return column


@kernel
def add_plane_gradient(level, index, is_smooth, ux, uy, uz, u, feature_gradient, row, first_column, out):
    """Add the gradient of `write_planes` at one point to that of one level's planes.

    Parameters
    ----------
    feature_gradient : float32 (N, columns); the planes' begin at (row, first_column)
    out : float32 (entries, features), added to
    """
    feature_count = out.shape[1]
    for plane in range(PLANES):
        column = first_column + (index * PLANES + plane) * feature_count
        c = ux if plane == 0 else (uy if plane == 1 else uz)
        entries, shares = _plane_corners(level, index, plane, c, u, is_smooth)
        for corner in range(4):
            for f in range(feature_count):
                out[entries[corner], f] += shares[corner] * feature_gradient[row, column + f]


@kernel
def step_table(table, gradient, moments, variances, average, average_step, decay, step, rate, beta1, beta2, epsilon):
    """One step of Adam for the entries that have a gradient, which is set back to zero; and of the running average.

    Entries without a gradient are left alone, moments included: most of a table belongs to no record of a batch. Their
    parameters stay as they are, so what the average missed is a power of its decay, caught up with at the entry's next
    step or by `catch_up`. Without an average, pass `table` for it and powers of zero.

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
    Kingma and Ba 2014, Algorithm 1. Müller et al. 2022, section 4 (skipping entries without gradient).
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
    """Bring the running average of every entry to `step`; parameters as in `step_table`."""
    for entry in range(table.shape[0]):
        missed = _power(decay, step - average_step[entry])
        average_step[entry] = step
        for f in range(table.shape[1]):
            average[entry, f] = table[entry, f] + missed * (average[entry, f] - table[entry, f])


@kernel
def _power(decay, exponent):
    return decay[exponent] if exponent < decay.shape[0] else np.float32(0.0)
