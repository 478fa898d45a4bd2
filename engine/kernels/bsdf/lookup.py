# SPDX-License-Identifier: GPL-3.0-or-later
"""Linear interpolation in the tables of `BsdfTables`, all float32 (planes, rows, columns)."""

import numpy as np

from engine.jit import kernel


@kernel
def table_position(x, size):
    """Lower index and fraction of coordinate `x`, clamped to [0, 1], on an axis of `size` samples."""
    position = min(max(x, 0.0), 1.0) * np.float32(size - 1)
    index = min(int(position), size - 2)
    return index, position - np.float32(index)


@kernel
def read_plane(table, plane, y, x):
    """Bilinear value of a plane; `x` along columns, `y` along rows."""
    row, v = table_position(y, table.shape[1])
    column, u = table_position(x, table.shape[2])
    lower = table[plane, row, column] * (1.0 - u) + table[plane, row, column + 1] * u
    upper = table[plane, row + 1, column] * (1.0 - u) + table[plane, row + 1, column + 1] * u
    return lower * (1.0 - v) + upper * v


@kernel
def read_volume(table, first_plane, plane_count, z, y, x):
    """Trilinear value in planes first_plane to first_plane + plane_count - 1."""
    plane, w = table_position(z, plane_count)
    plane += first_plane
    return read_plane(table, plane, y, x) * (1.0 - w) + read_plane(table, plane + 1, y, x) * w


@kernel
def read_row(table, x):
    """Linear value in the only row of a table."""
    column, u = table_position(x, table.shape[2])
    return table[0, 0, column] * (1.0 - u) + table[0, 0, column + 1] * u
