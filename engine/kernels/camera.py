# SPDX-License-Identifier: GPL-3.0-or-later
"""Camera rays."""

import math

import numpy as np

from engine.kernels.constants import TWO_PI
from engine.kernels.motion import apply_direction, apply_point, matrix_between
from engine.kernels.panorama import move_eye, panorama_direction, panorama_lens
from engine.kernels.rounding import floor_of
from engine.kernels.vector import (
    add,
    dot,
    length,
    normalize,
    scale,
    subtract,
    transform_direction,
    transform_point,
)
from engine.runtime.jit import kernel
from engine.state.camera import (
    CAMERA_BLADE_ROTATION,
    CAMERA_BLADES,
    CAMERA_CLIP_END,
    CAMERA_CLIP_START,
    CAMERA_EYE_OFFSET,
    CAMERA_FOCUS,
    CAMERA_INVERSE_RATIO,
    CAMERA_IS_ZOOMING,
    CAMERA_KIND,
    CAMERA_LENS_RADIUS,
    CAMERA_OFFSET_X,
    CAMERA_OFFSET_Y,
    CAMERA_ROLLING,
    CAMERA_ROW_COUNT,
    CAMERA_SCALE_X,
    CAMERA_SCALE_Y,
    CAMERA_ZOOM_CLOSING,
    CAMERA_ZOOM_OPENING,
    KIND_ORTHOGRAPHIC,
    KIND_PANORAMA,
    KIND_PERSPECTIVE,
)


@kernel
def sample_table(table, u):
    """What uniform `u` in [0, 1] becomes by an inverse CDF, `table`: an offset in a pixel, a time of the shutter."""
    last = table.shape[0] - 1
    x = u * np.float32(last)
    index = min(int(x), last - 1)
    fraction = x - np.float32(index)
    return table[index] * (1.0 - fraction) + table[index + 1] * fraction


@kernel
def time_of_row(camera, time, row):
    """When a path sees the world: its time of the shutter, and where the rolling shutter is at its row, from the top.

    Parameters
    ----------
    camera : float32 (CAMERA_WIDTH,)
    time : float32, in [0, 1], drawn by the shutter's curve
    row : int, of the full image, 0 at the bottom
    """
    rolling = camera[CAMERA_ROLLING]
    if rolling > 0.0:
        time = time * (1.0 - rolling) + (1.0 - np.float32(row) / camera[CAMERA_ROW_COUNT]) * rolling
    return time


@kernel
def zoom_at(camera, time):
    """Film coordinates at a time of the shutter over those in its middle: straight on either side, as in Cycles."""
    away = 2.0 * time - 1.0
    if away < 0.0:
        return 1.0 - away * (camera[CAMERA_ZOOM_OPENING] - 1.0)
    return 1.0 + away * (camera[CAMERA_ZOOM_CLOSING] - 1.0)


@kernel
def sample_aperture(camera, u, v):
    """Point on the unit lens: a disc, or a regular polygon of as many sides as the iris has blades."""
    blades = int(camera[CAMERA_BLADES])
    if blades == 0:
        angle = TWO_PI * u
        radius = math.sqrt(v)
        x = radius * math.cos(angle)
        y = radius * math.sin(angle)
    else:
        corner = np.float32(floor_of(u * camera[CAMERA_BLADES]))
        u = u * camera[CAMERA_BLADES] - corner
        step = TWO_PI / camera[CAMERA_BLADES]
        # Uniform in the triangle of two neighbouring corners and the centre.
        root = math.sqrt(u)
        along = v * root
        a = 1.0 - root
        # As in Cycles, the middle of a side lies where the rotation says.
        first = camera[CAMERA_BLADE_ROTATION] + (corner - np.float32(0.5)) * step
        # barycentrics (a: centre, along, rest)
        rest = 1.0 - a - along
        x = along * math.cos(first + step) + rest * math.cos(first)
        y = along * math.sin(first + step) + rest * math.sin(first)
    return x * camera[CAMERA_INVERSE_RATIO], y


@kernel
def generate_ray(camera, motion, x, y, lens_u, lens_v, time):
    """Ray through film position (x, y) [pixels, from the bottom left], at a time of the shutter.

    Parameters
    ----------
    camera : float32 (CAMERA_WIDTH,)
    motion : float32 (K, 12), camera to world, as `CameraArrays.motion`

    Returns
    -------
    origin, direction : 3-tuples, world; direction 0 where a panorama's film sees nothing
    near, far : float32, distances between which the camera sees
    radius, spread : float32, compact ray differential
    """
    film_x = x * camera[CAMERA_SCALE_X] + camera[CAMERA_OFFSET_X]
    film_y = y * camera[CAMERA_SCALE_Y] + camera[CAMERA_OFFSET_Y]
    kind = int(camera[CAMERA_KIND])
    position = (0.0, 0.0, 0.0)
    near = camera[CAMERA_CLIP_START]
    far = camera[CAMERA_CLIP_END]
    radius = 0.0
    spread = 0.0
    if kind == KIND_ORTHOGRAPHIC:
        position = (film_x, film_y, 0.0)
        direction = (0.0, 0.0, -1.0)
        radius = camera[CAMERA_SCALE_X]
    elif kind == KIND_PANORAMA:
        direction = panorama_direction(camera, film_x, film_y)
        if dot(direction, direction) == 0.0:
            return position, direction, near, far, radius, spread
        direction = normalize(direction)
        beside = panorama_direction(camera, film_x + camera[CAMERA_SCALE_X], film_y)
        above = panorama_direction(camera, film_x, film_y + camera[CAMERA_SCALE_Y])
        spread = 0.5 * (length(subtract(normalize(beside), direction)) + length(subtract(normalize(above), direction)))
    else:
        if camera[CAMERA_IS_ZOOMING] > 0.0:
            zoom = zoom_at(camera, time)
            film_x *= zoom
            film_y *= zoom
        direction = (film_x, film_y, -1.0)
        # How far the unit direction moves from one pixel to the next, mean of x and y.
        squared = film_x * film_x + film_y * film_y + 1.0
        across_x = abs(camera[CAMERA_SCALE_X]) * math.sqrt(squared - film_x * film_x)
        across_y = abs(camera[CAMERA_SCALE_Y]) * math.sqrt(squared - film_y * film_y)
        spread = 0.5 * (across_x + across_y) / squared
    if camera[CAMERA_LENS_RADIUS] > 0.0:
        lens_x, lens_y = sample_aperture(camera, lens_u, lens_v)
        lens_x *= camera[CAMERA_LENS_RADIUS]
        lens_y *= camera[CAMERA_LENS_RADIUS]
        if kind == KIND_PANORAMA:
            across, up = panorama_lens(camera, direction)
            focus = scale(direction, camera[CAMERA_FOCUS])
            position = add(scale(across, lens_x), scale(up, lens_y))
            direction = subtract(focus, position)
        else:
            focus = add(position, scale(direction, camera[CAMERA_FOCUS]))
            position = (position[0] + lens_x, position[1] + lens_y, position[2])
            direction = subtract(focus, position)
    direction = normalize(direction)
    if kind == KIND_PERSPECTIVE:
        # Blender clips by depth, not by distance.
        along = -1.0 / direction[2]
        near *= along
        far *= along
    has_eye = camera[CAMERA_EYE_OFFSET] != 0.0
    if has_eye and kind == KIND_PANORAMA:
        position, direction = move_eye(camera, position, direction, (0.0, 1.0, 0.0))
    if motion.shape[0] > 1:
        matrix = matrix_between(motion, 0, motion.shape[0], time)
        origin, direction = apply_point(matrix, position), normalize(apply_direction(matrix, direction))
    else:
        origin = transform_point(motion, 0, position)
        direction = normalize(transform_direction(motion, 0, direction))
    if has_eye and kind == KIND_PERSPECTIVE:
        # As in Cycles, the eyes of a flat picture are level in the world.
        origin, direction = move_eye(camera, origin, direction, (0.0, 0.0, 1.0))
    return origin, direction, near, far, radius, spread
