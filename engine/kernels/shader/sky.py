# SPDX-License-Identifier: GPL-3.0-or-later
"""Radiance of skies by direction, from a map or by a formula (engine.sky). Colours are of the working space."""

import math

import numpy as np

from engine.kernels.constants import INV_TWO_PI
from engine.runtime.jit import kernel

#: What a sky is told by: columns of its table.
SKY_MAP = 0
SKY_DAYLIGHT = 1
SKY_CHROMATIC_DAYLIGHT = 2

#: Of a map: radiance of the sun's disc at its lowest and highest point, elevation and azimuth of its centre from y
#: towards -x, half of its angle (0 = no disc), the elevation above which it is seen, and 3 floats for each texel.
MAP_BOTTOM = 0
MAP_TOP = 3
MAP_ELEVATION = 6
MAP_ROTATION = 7
MAP_HALF_ANGLE = 8
MAP_LOWEST = 9
MAP_TEXELS = 10

#: Of a formula: 9 coefficients by channel, radiance, the sun's angle to the zenith and its azimuth from y towards x,
#: what is added to cosines to the zenith, and the matrix from CIE XYZ.
DAYLIGHT_RADIANCE = 27
DAYLIGHT_THETA = 30
DAYLIGHT_PHI = 31
DAYLIGHT_HORIZON = 32
DAYLIGHT_MATRIX = 33

MAP_WIDTH = 512
MAP_HEIGHT = 256
_HALF_PI = np.float32(0.5 * math.pi)
#: Nearest to the horizon that formulas are asked.
_LOWEST = np.float32(0.5 * math.pi - 0.001)
_LIMB_DARKENING = np.float32(0.6)


@kernel
def sun_disc_axis(tables, table):
    """Unit direction to the centre of a map's sun."""
    elevation = tables[table + MAP_ELEVATION]
    rotation = tables[table + MAP_ROTATION]
    across = math.cos(elevation)
    return -across * math.sin(rotation), across * math.cos(rotation), math.sin(elevation)


@kernel
def _angle_between(a, b):
    """Angle between two unit vectors, precise where it is small."""
    x, y, z = a[0] - b[0], a[1] - b[1], a[2] - b[2]
    u, v, w = a[0] + b[0], a[1] + b[1], a[2] + b[2]
    return 2.0 * math.atan2(math.sqrt(x * x + y * y + z * z), math.sqrt(u * u + v * v + w * w))


@kernel
def _elevation(d):
    return _HALF_PI - math.acos(min(max(d[2], -1.0), 1.0))


@kernel
def _disc(tables, table, d, elevation):
    """How far up the sun's disc a direction lies, and how much of its light the limb leaves; (0, 0) beside it."""
    half_angle = tables[table + MAP_HALF_ANGLE]
    none = 0.0 * elevation
    if not half_angle > 0.0 or not elevation > tables[table + MAP_LOWEST]:
        return none, none
    angle = _angle_between(d, sun_disc_axis(tables, table))
    if not angle < half_angle:
        return none, none
    share = angle / half_angle
    up = 0.5 * (elevation - tables[table + MAP_ELEVATION]) / half_angle + 0.5
    return up, 1.0 - _LIMB_DARKENING * (1.0 - math.sqrt(1.0 - share * share))


@kernel
def _map_sky(tables, table, d):
    elevation = _elevation(d)
    up, limb = _disc(tables, table, d, elevation)
    x = (tables[table + MAP_ROTATION] - math.atan2(d[1], d[0]) - _HALF_PI) * INV_TWO_PI
    x = (x - math.floor(x)) * MAP_WIDTH - 0.5
    l = math.sqrt(abs(elevation) / _HALF_PI)
    y = (0.5 + 0.5 * (l if elevation >= 0.0 else -l)) * MAP_HEIGHT - 0.5
    column, row = int(math.floor(x)), int(math.floor(y))
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
def _daylight(tables, first, radiance, horizon, cos_theta, gamma):
    """One channel of the formula (`engine.sky.daylight`)."""
    cos_gamma = math.cos(gamma)
    squared = cos_gamma * cos_gamma
    denominator = 1.0 + tables[first + 8] * tables[first + 8] - 2.0 * tables[first + 8] * cos_gamma
    mie = (1.0 + squared) / (denominator * math.sqrt(denominator)) if tables[first + 6] != 0.0 else 0.0 * gamma
    around = tables[first + 2] + tables[first + 3] * math.exp(tables[first + 4] * gamma)
    around += tables[first + 5] * squared + tables[first + 6] * mie + tables[first + 7] * math.sqrt(cos_theta)
    return radiance * (1.0 + tables[first] * math.exp(tables[first + 1] / (cos_theta + horizon))) * around


@kernel
def _daylight_sky(tables, table, is_chromatic, d):
    theta = math.acos(min(max(d[2], -1.0), 1.0))
    phi = _HALF_PI - math.atan2(d[1], d[0])
    sun_theta = tables[table + DAYLIGHT_THETA]
    cosine = math.sin(theta) * math.sin(sun_theta) * math.cos(tables[table + DAYLIGHT_PHI] - phi)
    cosine += math.cos(theta) * math.cos(sun_theta)
    gamma = math.acos(min(max(cosine, -1.0), 1.0))
    cos_theta = math.cos(min(theta, _LOWEST))
    horizon = tables[table + DAYLIGHT_HORIZON]
    x = _daylight(tables, table, tables[table + DAYLIGHT_RADIANCE], horizon, cos_theta, gamma)
    y = _daylight(tables, table + 9, tables[table + DAYLIGHT_RADIANCE + 1], horizon, cos_theta, gamma)
    z = _daylight(tables, table + 18, tables[table + DAYLIGHT_RADIANCE + 2], horizon, cos_theta, gamma)
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
