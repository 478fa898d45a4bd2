# SPDX-License-Identifier: GPL-3.0-or-later
"""Radiance of skies by direction, from a map or by a formula (engine.sky). Colours are of the working space."""

import math

import numpy as np

from engine.kernels.angles import upper_angle
from engine.kernels.constants import INV_TWO_PI
from engine.kernels.rounding import floor_of
from engine.runtime.jit import kernel

#: What a sky is told by: columns of its table.
SKY_MAP = 0
SKY_DAYLIGHT = 1
SKY_CHROMATIC_DAYLIGHT = 2

#: Of a map: radiance of the sun's disc at its lowest and highest point, elevation and azimuth of its centre from y
#: towards -x, half of its angle (0 = no disc), the elevation above which it is seen, the unit direction to its centre,
#: a bound of the squared tangent of a quarter of its angle, and 3 floats for each texel.
MAP_BOTTOM = 0
MAP_TOP = 3
MAP_ELEVATION = 6
MAP_ROTATION = 7
MAP_HALF_ANGLE = 8
MAP_LOWEST = 9
MAP_AXIS = 10
MAP_RIM = 13
MAP_TEXELS = 14

#: Of a formula: 9 coefficients by channel, radiance, the unit direction to the sun, what is added to cosines to the
#: zenith, and the matrix from CIE XYZ.
DAYLIGHT_RADIANCE = 27
DAYLIGHT_SUN = 30
DAYLIGHT_HORIZON = 33
DAYLIGHT_MATRIX = 34

MAP_WIDTH = 512
MAP_HEIGHT = 256
_WIDTH, _HEIGHT = np.float32(MAP_WIDTH), np.float32(MAP_HEIGHT)
_HALF_PI = np.float32(0.5 * math.pi)
_INV_HALF_PI = np.float32(2.0 / math.pi)
#: Cosine of the angle nearest to the horizon that formulas are asked.
_LOWEST_COSINE = np.float32(math.sin(0.001))
_LIMB_DARKENING = np.float32(0.6)


@kernel
def _disc(tables, table, d, elevation):
    """How far up the sun's disc a direction lies, and how much of its light the limb leaves; (0, 0) beside it."""
    half_angle = tables[table + MAP_HALF_ANGLE]
    none = 0.0 * elevation
    if not half_angle > 0.0 or not elevation > tables[table + MAP_LOWEST]:
        return none, none
    axis = table + MAP_AXIS
    x, y, z = d[0] - tables[axis], d[1] - tables[axis + 1], d[2] - tables[axis + 2]
    u, v, w = d[0] + tables[axis], d[1] + tables[axis + 1], d[2] + tables[axis + 2]
    across, along = x * x + y * y + z * z, u * u + v * v + w * w
    # Most directions are far from it, and need no angle.
    if across > along * tables[table + MAP_RIM]:
        return none, none
    # Precise where it is small.
    angle = 2.0 * upper_angle(math.sqrt(across), math.sqrt(along))
    if not angle < half_angle:
        return none, none
    share = angle / half_angle
    up = 0.5 * (elevation - tables[table + MAP_ELEVATION]) / half_angle + 0.5
    return up, 1.0 - _LIMB_DARKENING * (1.0 - math.sqrt(1.0 - share * share))


@kernel
def _map_sky(tables, table, d):
    z = min(max(d[2], -1.0), 1.0)
    height = upper_angle(abs(z), math.sqrt((1.0 - z) * (1.0 + z)))
    elevation = -height if z < 0.0 else height
    up, limb = _disc(tables, table, d, elevation)
    turn = upper_angle(abs(d[1]), d[0])
    x = (tables[table + MAP_ROTATION] - (-turn if d[1] < 0.0 else turn) - _HALF_PI) * INV_TWO_PI
    x = (x - np.float32(floor_of(x))) * _WIDTH - 0.5
    l = math.sqrt(height * _INV_HALF_PI)
    y = (0.5 + 0.5 * (-l if z < 0.0 else l)) * _HEIGHT - 0.5
    column, row = floor_of(x), floor_of(y)
    dx, dy = x - np.float32(column), y - np.float32(row)
    left, right = max(column, 0), min(column + 1, MAP_WIDTH - 1)
    below, above = max(row, 0), min(row + 1, MAP_HEIGHT - 1)
    first = table + MAP_TEXELS
    a, b = first + 3 * (below * MAP_WIDTH + left), first + 3 * (below * MAP_WIDTH + right)
    e, f = first + 3 * (above * MAP_WIDTH + left), first + 3 * (above * MAP_WIDTH + right)
    disc = table + MAP_BOTTOM
    wa, wb, we, wf = (1.0 - dx) * (1.0 - dy), dx * (1.0 - dy), (1.0 - dx) * dy, dx * dy
    red = wa * tables[a] + wb * tables[b] + we * tables[e] + wf * tables[f]
    green = wa * tables[a + 1] + wb * tables[b + 1] + we * tables[e + 1] + wf * tables[f + 1]
    blue = wa * tables[a + 2] + wb * tables[b + 2] + we * tables[e + 2] + wf * tables[f + 2]
    if limb > 0.0:
        red += limb * (tables[disc] * (1.0 - up) + tables[disc + 3] * up)
        green += limb * (tables[disc + 1] * (1.0 - up) + tables[disc + 4] * up)
        blue += limb * (tables[disc + 2] * (1.0 - up) + tables[disc + 5] * up)
    return max(red, 0.0), max(green, 0.0), max(blue, 0.0)


@kernel
def _daylight(tables, first, radiance, horizon, cos_theta, gamma, cos_gamma):
    """One channel of the formula (`engine.sky.daylight`)."""
    squared = cos_gamma * cos_gamma
    denominator = 1.0 + tables[first + 8] * tables[first + 8] - 2.0 * tables[first + 8] * cos_gamma
    mie = (1.0 + squared) / (denominator * math.sqrt(denominator)) if tables[first + 6] != 0.0 else 0.0 * gamma
    around = tables[first + 2] + tables[first + 3] * math.exp(tables[first + 4] * gamma)
    around += tables[first + 5] * squared + tables[first + 6] * mie + tables[first + 7] * math.sqrt(cos_theta)
    return radiance * (1.0 + tables[first] * math.exp(tables[first + 1] / (cos_theta + horizon))) * around


@kernel
def _daylight_sky(tables, table, is_chromatic, d):
    z = min(max(d[2], -1.0), 1.0)
    squared = d[0] * d[0] + d[1] * d[1]
    # Of a direction that is no unit vector, the one with its height and its azimuth.
    scale = math.sqrt((1.0 - z) * (1.0 + z) / squared) if squared > 0.0 else 0.0 * z
    sun = table + DAYLIGHT_SUN
    cosine = scale * (d[0] * tables[sun] + d[1] * tables[sun + 1]) + z * tables[sun + 2]
    cosine = min(max(cosine, -1.0), 1.0)
    gamma = upper_angle(math.sqrt((1.0 - cosine) * (1.0 + cosine)), cosine)
    cos_theta = max(z, _LOWEST_COSINE)
    horizon = tables[table + DAYLIGHT_HORIZON]
    x = _daylight(tables, table, tables[table + DAYLIGHT_RADIANCE], horizon, cos_theta, gamma, cosine)
    y = _daylight(tables, table + 9, tables[table + DAYLIGHT_RADIANCE + 1], horizon, cos_theta, gamma, cosine)
    z = _daylight(tables, table + 18, tables[table + DAYLIGHT_RADIANCE + 2], horizon, cos_theta, gamma, cosine)
    if is_chromatic:
        luminance, u, v = x, y, z
        scale = luminance / v if v != 0.0 else 0.0 * v
        x, y, z = u * scale, luminance, (1.0 - u - v) * scale
    m = table + DAYLIGHT_MATRIX
    return (
        max(tables[m] * x + tables[m + 1] * y + tables[m + 2] * z, 0.0),
        max(tables[m + 3] * x + tables[m + 4] * y + tables[m + 5] * z, 0.0),
        max(tables[m + 6] * x + tables[m + 7] * y + tables[m + 8] * z, 0.0),
    )


@kernel
def sky_color(tables, table, kind, d):
    """Radiance from a direction: (red, green, blue).

    Parameters
    ----------
    tables : float32 (N,)
    table : int, where the sky's begins
    kind : int, SKY_*
    d : tuple of float
        Where to look; not normalized, as in Cycles.
    """
    if kind == SKY_MAP:
        return _map_sky(tables, table, d)
    return _daylight_sky(tables, table, kind == SKY_CHROMATIC_DAYLIGHT, d)
