# SPDX-License-Identifier: GPL-3.0-or-later
"""Light of luminaires by direction, from tables of photometric files (engine.shaders.photometry).

A table: counts of horizontal and vertical angles, those angles [rad], and for each horizontal angle its intensities.
"""

import math

import numpy as np

from engine.kernels.constants import PI, TWO_PI
from engine.kernels.vector import normalize
from engine.runtime.jit import kernel

_CLOSE = np.float32(1e-7)


@kernel
def _last_below(tables, first, count, angle):
    """The last of rising angles, but for the very last, below `angle`; 0 if there is none."""
    low = 0
    high = count - 1
    while high - low > 1:
        middle = (low + high) >> 1
        if tables[first + middle] < angle:
            low = middle
        else:
            high = middle
    return low


@kernel
def _cubic(a, b, c, d, x):
    """Catmull and Rom's spline between b and c."""
    return 0.5 * (((d + 3.0 * (b - c) - a) * x + (2.0 * a - 5.0 * b + 4.0 * c - d)) * x + (c - a)) * x + b


@kernel
def _along(tables, line, count, i, x, wraps_low, wraps_high):
    """Intensity between the i-th and the next vertical angle of a line of the table."""
    b = tables[line + i]
    c = tables[line + i + 1]
    a = tables[line + i - 1] if i > 0 else (tables[line + 1] if wraps_low else b)
    d = tables[line + i + 2] if i + 2 < count else (tables[line + count - 2] if wraps_high else c)
    return _cubic(a, b, c, d, x)


@kernel
def ies_intensity(tables, table, direction):
    """Intensity towards a direction, which need not be of unit length; 0 beyond the angles of the table."""
    d = normalize(direction)
    vertical = math.acos(min(max(-d[2], -1.0), 1.0))
    horizontal = math.atan2(d[0], d[1]) + PI
    h_count, v_count = int(tables[table]), int(tables[table + 1])
    h, v = table + 2, table + 2 + h_count
    none = 0.0 * vertical
    if vertical < tables[v] or vertical >= tables[v + v_count - 1]:
        return none
    if horizontal < tables[h] or horizontal >= tables[h + h_count - 1]:
        return none
    wraps = tables[h] < _CLOSE and tables[h + h_count - 1] > TWO_PI - _CLOSE
    wraps_low, wraps_high = tables[v] < _CLOSE, tables[v + v_count - 1] > PI - _CLOSE
    i = _last_below(tables, h, h_count, horizontal)
    j = _last_below(tables, v, v_count, vertical)
    x = (horizontal - tables[h + i]) / (tables[h + i + 1] - tables[h + i])
    y = (vertical - tables[v + j]) / (tables[v + j + 1] - tables[v + j])
    lines = v + v_count
    b = _along(tables, lines + i * v_count, v_count, j, y, wraps_low, wraps_high)
    c = _along(tables, lines + (i + 1) * v_count, v_count, j, y, wraps_low, wraps_high)
    # Beyond the last line Cycles goes on with this one, not with the next.
    before = i - 1 if i > 0 else (h_count - 2 if wraps else i)
    behind = i + 2 if i + 2 < h_count else (1 if wraps else i)
    a = _along(tables, lines + before * v_count, v_count, j, y, wraps_low, wraps_high)
    e = _along(tables, lines + behind * v_count, v_count, j, y, wraps_low, wraps_high)
    return max(_cubic(a, b, c, e, x), none)
