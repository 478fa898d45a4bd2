# SPDX-License-Identifier: GPL-3.0-or-later
"""The background as a light: directions drawn from a map of its radiance.

Rows are bands of latitude, row 0 around z = -1; columns follow Blender's equirectangular projection:
u = 1/2 - atan2(y, x) / 2 pi. Within a cell directions are uniform in solid angle, so the density is constant per cell
and exact at the poles.
"""

import math

import numpy as np

from engine.kernels.constants import INV_PI, INV_TWO_PI, PI, TWO_PI
from engine.kernels.vector import dot
from engine.runtime.jit import kernel
from engine.state.lights import MAP_GUIDE_SIZE

_GUIDE_STEPS = np.float32(MAP_GUIDE_SIZE)


@kernel
def _find_row(marginal, guide, row_count, u):
    """Last row whose cumulative probability is not above u."""
    step = int(u * _GUIDE_STEPS)
    low = np.int64(guide[row_count, step])
    high = np.int64(guide[row_count, step + 1]) + 1
    while high - low > 1:
        middle = (low + high) >> 1
        if marginal[middle, 0] <= u:
            low = middle
        else:
            high = middle
    return low


@kernel
def _find_column(conditional, guide, row, u):
    """Last column of a row whose cumulative probability is not above u."""
    step = int(u * _GUIDE_STEPS)
    low = np.int64(guide[row, step])
    high = np.int64(guide[row, step + 1]) + 1
    while high - low > 1:
        middle = (low + high) >> 1
        if conditional[row, middle] <= u:
            low = middle
        else:
            high = middle
    return low


@kernel
def _cell_pdf(marginal, conditional, row, column, column_count):
    probability = (marginal[row + 1, 0] - marginal[row, 0]) * (
        conditional[row, column + 1] - conditional[row, column]
    )
    height = marginal[row + 1, 1] - marginal[row, 1]
    return probability * np.float32(column_count) * INV_TWO_PI / height


@kernel
def sample_map(marginal, conditional, guide, u0, u1):
    """Direction towards the background and its density [sr^-1] (0 = none)."""
    row_count = conditional.shape[0]
    column_count = conditional.shape[1] - 1
    row = _find_row(marginal, guide, row_count, u1)
    low = marginal[row, 0]
    high = marginal[row + 1, 0]
    dv = 0.0 * u0
    if high > low:
        dv = min(1.0, (u1 - low) / (high - low))
    column = _find_column(conditional, guide, row, u0)
    low = conditional[row, column]
    high = conditional[row, column + 1]
    du = 0.0 * u0
    if high > low:
        du = min(1.0, (u0 - low) / (high - low))
    z = marginal[row, 1] + dv * (marginal[row + 1, 1] - marginal[row, 1])
    phi = PI - TWO_PI * ((np.float32(column) + du) / np.float32(column_count))
    r = math.sqrt(max(0.0, 1.0 - z * z))
    pdf = _cell_pdf(marginal, conditional, row, column, column_count)
    return pdf, (r * math.cos(phi), r * math.sin(phi), z)


@kernel
def map_pdf(marginal, conditional, direction):
    """Density [sr^-1] of `sample_map` for a direction (any length)."""
    row_count = conditional.shape[0]
    column_count = conditional.shape[1] - 1
    z = direction[2] / math.sqrt(dot(direction, direction))
    v = 1.0 - math.acos(min(1.0, max(-1.0, z))) * INV_PI
    u = 0.5 - math.atan2(direction[1], direction[0]) * INV_TWO_PI
    row = min(row_count - 1, max(0, int(v * np.float32(row_count))))
    column = min(column_count - 1, max(0, int(u * np.float32(column_count))))
    return _cell_pdf(marginal, conditional, row, column, column_count)
