# SPDX-License-Identifier: GPL-3.0-or-later
"""What panoramic cameras see where: from the film to directions, and back.

Directions are in the camera's space: it looks along -z, y is up. Film coordinates are 0 to 1 over the whole film, but
angles [rad] of equirectangular cameras. The mappings are those of Cycles.
"""

import math

import numpy as np

from engine.kernels.constants import HALF_PI
from engine.kernels.vector import add, cross, dot, normalize, scale, subtract
from engine.runtime.jit import kernel
from engine.state.camera import (
    CAMERA_CONVERGENCE,
    CAMERA_EYE_OFFSET,
    CAMERA_MERGE_FROM,
    CAMERA_MERGE_TO,
    CAMERA_PANORAMA,
    CAMERA_PANORAMA_FIRST,
    PANORAMA_BOTTOM,
    PANORAMA_CUBEMAP_FACE,
    PANORAMA_CYLINDER_BOTTOM,
    PANORAMA_CYLINDER_LEFT,
    PANORAMA_CYLINDER_RIGHT,
    PANORAMA_CYLINDER_TOP,
    PANORAMA_CYLINDRICAL,
    PANORAMA_EQUIDISTANT,
    PANORAMA_EQUIRECTANGULAR,
    PANORAMA_EQUISOLID,
    PANORAMA_FOV,
    PANORAMA_HEIGHT,
    PANORAMA_LEFT,
    PANORAMA_LENS,
    PANORAMA_MIRROR_BALL,
    PANORAMA_POLYNOMIAL,
    PANORAMA_RIGHT,
    PANORAMA_TOP,
    PANORAMA_WIDTH,
)

_NOWHERE = (np.float32(0.0), np.float32(0.0), np.float32(0.0))
_NEWTON_STEPS = 20


@kernel
def _parameter(camera, column):
    return camera[CAMERA_PANORAMA_FIRST + column]


@kernel
def _fisheye_direction(theta, u, v, r):
    """Direction `theta` [rad] away from the axis, towards (u, v) of length `r`."""
    if r == 0.0:
        return 0.0, 0.0, -1.0
    sine = math.sin(theta) / r
    return u * sine, v * sine, -math.cos(theta)


@kernel
def _polynomial_angle(camera, r):
    """Angle [rad] to the axis at `r` [mm] from the middle of the film."""
    angle = _parameter(camera, PANORAMA_POLYNOMIAL + 4)
    for power in range(3, -1, -1):
        angle = angle * r + _parameter(camera, PANORAMA_POLYNOMIAL + power)
    return -angle


@kernel
def _polynomial_radius(camera, theta):
    """Distance [mm] from the middle of the film where the angle to the axis is `theta`, by Newton's method."""
    first = PANORAMA_POLYNOMIAL
    r = (-theta - _parameter(camera, first)) / _parameter(camera, first + 1)
    for _ in range(_NEWTON_STEPS):
        slope = np.float32(0.0)
        for power in range(4, 0, -1):
            slope = slope * r + np.float32(power) * _parameter(camera, first + power)
        change = (_polynomial_angle(camera, r) - theta) / slope
        r += change
        if abs(change) < 1e-6:
            break
    return r


@kernel
def panorama_direction(camera, x, y):
    """Where a panoramic camera looks at a place on its film.

    Parameters
    ----------
    camera : float32 (CAMERA_WIDTH,)
    x, y : float32, film coordinates

    Returns
    -------
    3-tuple, of any length; zero where the film sees nothing
    """
    kind = int(camera[CAMERA_PANORAMA])
    if kind == PANORAMA_EQUIRECTANGULAR:
        # Longitude 0 looks along -z, growing to the right; latitude up.
        horizontal = math.cos(y)
        return math.sin(x) * horizontal, math.sin(y), -math.cos(x) * horizontal
    if kind == PANORAMA_CUBEMAP_FACE:
        return math.tan((x - 0.5) * HALF_PI), math.tan((y - 0.5) * HALF_PI), -1.0
    if kind == PANORAMA_CYLINDRICAL:
        left, right = _parameter(camera, PANORAMA_CYLINDER_LEFT), _parameter(camera, PANORAMA_CYLINDER_RIGHT)
        low, high = _parameter(camera, PANORAMA_CYLINDER_BOTTOM), _parameter(camera, PANORAMA_CYLINDER_TOP)
        angle = left + x * (right - left)
        return math.sin(angle), low + y * (high - low), -math.cos(angle)
    if kind == PANORAMA_MIRROR_BALL:
        # The point of the ball, and the direction in which it reflects what looks along -z.
        u, v = 2.0 * x - 1.0, 2.0 * y - 1.0
        squared = u * u + v * v
        if squared > 1.0:
            return _NOWHERE
        depth = math.sqrt(max(1.0 - squared, 0.0))
        return 2.0 * depth * u, 2.0 * depth * v, 1.0 - 2.0 * (1.0 - squared)
    if kind == PANORAMA_EQUIDISTANT:
        u, v = 2.0 * x - 1.0, 2.0 * y - 1.0
        r = math.sqrt(u * u + v * v)
        if r > 1.0:
            return _NOWHERE
        return _fisheye_direction(0.5 * r * _parameter(camera, PANORAMA_FOV), u, v, r)
    u = (x - 0.5) * _parameter(camera, PANORAMA_WIDTH)
    v = (y - 0.5) * _parameter(camera, PANORAMA_HEIGHT)
    r = math.sqrt(u * u + v * v)
    if kind == PANORAMA_EQUISOLID:
        lens = _parameter(camera, PANORAMA_LENS)
        if r > 2.0 * lens * math.sin(0.25 * _parameter(camera, PANORAMA_FOV)):
            return _NOWHERE
        return _fisheye_direction(2.0 * math.asin(min(r / (2.0 * lens), 1.0)), u, v, r)
    theta = _polynomial_angle(camera, r)
    if not abs(theta) <= 0.5 * _parameter(camera, PANORAMA_FOV):
        return _NOWHERE
    return _fisheye_direction(theta, u, v, r)


@kernel
def panorama_position(camera, d):
    """Where on its film a panoramic camera sees a direction: `panorama_direction` undone.

    Parameters
    ----------
    camera : float32 (CAMERA_WIDTH,)
    d : 3-tuple, unit

    Returns
    -------
    x, y : float32, film coordinates
    """
    kind = int(camera[CAMERA_PANORAMA])
    if kind == PANORAMA_EQUIRECTANGULAR:
        return math.atan2(d[0], -d[2]), math.asin(min(max(d[1], -1.0), 1.0))
    if kind == PANORAMA_CUBEMAP_FACE:
        return 0.5 + math.atan2(d[0], -d[2]) / HALF_PI, 0.5 + math.atan2(d[1], -d[2]) / HALF_PI
    if kind == PANORAMA_CYLINDRICAL:
        left, right = _parameter(camera, PANORAMA_CYLINDER_LEFT), _parameter(camera, PANORAMA_CYLINDER_RIGHT)
        low, high = _parameter(camera, PANORAMA_CYLINDER_BOTTOM), _parameter(camera, PANORAMA_CYLINDER_TOP)
        height = d[1] / max(math.sqrt(d[0] * d[0] + d[2] * d[2]), 1e-20)
        angle = math.atan2(d[0], -d[2])
        return (angle - left) / (right - left), (height - low) / (high - low)
    if kind == PANORAMA_MIRROR_BALL:
        depth = 2.0 * math.sqrt(max(0.5 * (1.0 - d[2]), 1e-20))
        return 0.5 * d[0] / depth + 0.5, 0.5 * d[1] / depth + 0.5
    across = math.sqrt(d[0] * d[0] + d[1] * d[1])
    theta = math.atan2(across, -d[2])
    inverse = 1.0 / max(across, 1e-20)
    if kind == PANORAMA_EQUIDISTANT:
        r = theta / _parameter(camera, PANORAMA_FOV) * inverse
        return 0.5 + r * d[0], 0.5 + r * d[1]
    if kind == PANORAMA_EQUISOLID:
        r = 2.0 * _parameter(camera, PANORAMA_LENS) * math.sin(0.5 * theta)
    else:
        r = _polynomial_radius(camera, theta)
    x = r * inverse * d[0] / _parameter(camera, PANORAMA_WIDTH)
    return 0.5 + x, 0.5 + r * inverse * d[1] / _parameter(camera, PANORAMA_HEIGHT)


@kernel
def panorama_window(camera, d):
    """Where on its whole film a panoramic camera sees a direction, from 0 to 1 across and up; its shift does not count.

    Parameters
    ----------
    camera : float32 (CAMERA_WIDTH,)
    d : 3-tuple, unit
    """
    x, y = panorama_position(camera, d)
    if int(camera[CAMERA_PANORAMA]) == PANORAMA_EQUIRECTANGULAR:
        left, bottom = _parameter(camera, PANORAMA_LEFT), _parameter(camera, PANORAMA_BOTTOM)
        x = (x - left) / (_parameter(camera, PANORAMA_RIGHT) - left)
        y = (y - bottom) / (_parameter(camera, PANORAMA_TOP) - bottom)
    return x, y


@kernel
def panorama_lens(camera, d):
    """The axes of a panoramic camera's lens, which faces the direction `d` (unit).

    Returns
    -------
    across, up : 3-tuples, unit
    """
    if int(camera[CAMERA_PANORAMA]) == PANORAMA_MIRROR_BALL:
        axis, sign = (1.0, 0.0, 0.0), -1.0
    else:
        axis, sign = (0.0, 0.0, -1.0), 1.0
    across = subtract(axis, scale(d, dot(axis, d)))
    if dot(across, across) < 1e-12:
        across = (0.0, 1.0, 0.0)
    across = normalize(across)
    return across, scale(cross(d, across), sign)


@kernel
def move_eye(camera, p, d, up):
    """Ray of an eye whose place goes by the direction it looks in.

    Parameters
    ----------
    camera : float32 (CAMERA_WIDTH,)
    p, d : 3-tuples, origin and unit direction of the ray from between the eyes
    up : 3-tuple, unit: what both eyes' line is perpendicular to

    Returns
    -------
    p, d : 3-tuples
    """
    offset = camera[CAMERA_EYE_OFFSET]
    height = dot(d, up)
    altitude = abs(math.asin(min(max(height, -1.0), 1.0)))
    first, last = camera[CAMERA_MERGE_FROM], camera[CAMERA_MERGE_TO]
    if altitude > last:
        return p, d
    if altitude > first:
        offset *= math.cos((altitude - first) / (last - first) * HALF_PI)
    side = cross(d, up)
    if dot(side, side) == 0.0:
        return p, d
    shift = scale(normalize(side), offset)
    convergence = camera[CAMERA_CONVERGENCE]
    if math.isfinite(convergence):
        d = normalize(subtract(scale(d, convergence), shift))
    return add(p, shift), d
