# SPDX-License-Identifier: GPL-3.0-or-later
"""Linear interpolation in `BsdfTables.data`, where tables of planes, rows and columns lie one after the other."""

import numpy as np

from engine.runtime.jit import kernel

# Offsets of the tables, see `BsdfTables`.
GLOSSY_ALBEDO = 0
GLOSSY_MEAN = GLOSSY_ALBEDO + 32 * 32
GLASS_ALBEDO = GLOSSY_MEAN + 32
GLASS_MEAN = GLASS_ALBEDO + 2 * 16 * 16 * 16
FRESNEL_BLEND = GLASS_MEAN + 2 * 16 * 16
SCHLICK_BLEND = FRESNEL_BLEND + 16 * 16 * 16
SHEEN_FIT = SCHLICK_BLEND + 16 * 16
TABLES_SIZE = SHEEN_FIT + 3 * 32 * 32


@kernel
def read_table(data, offset, size, y, x):
    """Bilinear value of a plane of size x size; `x` in [0, 1] along columns, `y` in [0, 1] along rows."""
    x = min(max(x, 0.0), 1.0) * np.float32(size - 1)
    y = min(max(y, 0.0), 1.0) * np.float32(size - 1)
    column = min(int(x), size - 2)
    row = min(int(y), size - 2)
    x -= np.float32(column)
    y -= np.float32(row)
    corner = offset + row * size + column
    lower = data[corner] * (1.0 - x) + data[corner + 1] * x
    upper = data[corner + size] * (1.0 - x) + data[corner + size + 1] * x
    return lower * (1.0 - y) + upper * y


@kernel
def read_volume(data, offset, size, z, y, x):
    """Trilinear value of `size` planes of `read_table`; `z` in [0, 1] across planes."""
    z = min(max(z, 0.0), 1.0) * np.float32(size - 1)
    plane = min(int(z), size - 2)
    z -= np.float32(plane)
    offset += plane * size * size
    lower = read_table(data, offset, size, y, x)
    return lower * (1.0 - z) + read_table(data, offset + size * size, size, y, x) * z
