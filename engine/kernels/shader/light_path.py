# SPDX-License-Identifier: GPL-3.0-or-later
"""What the Light Path, Object Info and camera inputs read."""

import numpy as np

from engine.kernels.panorama import panorama_window
from engine.kernels.shader.surface import read_point
from engine.kernels.vector import add, normalize, transform_direction, transform_point
from engine.runtime.jit import kernel
from engine.state.camera import CAMERA_KIND, KIND_PANORAMA, KIND_PERSPECTIVE
from engine.state.geometry import INSTANCE_PASS_INDEX
from engine.state.lanes import (
    POINT_DIFFUSE_DEPTH,
    POINT_GLOSSY_DEPTH,
    POINT_INSTANCE,
    POINT_LIGHT,
    POINT_PATH_DEPTH,
    POINT_PROGRAM,
    POINT_RAY_FLAGS,
    POINT_RAY_LENGTH,
    POINT_TANGENT,
    POINT_TRANSMISSION_DEPTH,
    POINT_TRANSPARENT_DEPTH,
    RAY_CAMERA,
    RAY_EMISSION,
    RAY_SHADOW,
)
from engine.state.shaders import CAMERA_LENS, CAMERA_TO_WORLD, CAMERA_WORLD_TO_CAMERA, CAMERA_WORLD_TO_NDC

#: Below LIGHT_PATH_LENGTH the kind is the bit of the ray flags itself.
LIGHT_PATH_LENGTH = 1 << 20
LIGHT_PATH_DEPTH = LIGHT_PATH_LENGTH + 1
LIGHT_PATH_DIFFUSE_DEPTH = LIGHT_PATH_LENGTH + 2
LIGHT_PATH_GLOSSY_DEPTH = LIGHT_PATH_LENGTH + 3
LIGHT_PATH_TRANSMISSION_DEPTH = LIGHT_PATH_LENGTH + 4
LIGHT_PATH_TRANSPARENT_DEPTH = LIGHT_PATH_LENGTH + 5

OBJECT_INDEX = 0
OBJECT_MATERIAL_INDEX = 1
OBJECT_RANDOM = 2
OBJECT_ALPHA = 3


@kernel
def light_path(points, lane, kind):
    """One output of the Light Path node."""
    integer = points.integer
    flags = integer[lane, POINT_RAY_FLAGS]
    value = 0
    if kind < LIGHT_PATH_LENGTH:
        return 1.0 if flags & kind else 0.0
    if kind == LIGHT_PATH_LENGTH:
        return points.real[lane, POINT_RAY_LENGTH]
    if kind == LIGHT_PATH_DEPTH:
        value = integer[lane, POINT_PATH_DEPTH]
        # Seen from a surface, emitters and blockers are one bounce further.
        if flags & (RAY_SHADOW | RAY_EMISSION):
            value += 1
    elif kind == LIGHT_PATH_DIFFUSE_DEPTH:
        value = integer[lane, POINT_DIFFUSE_DEPTH]
    elif kind == LIGHT_PATH_GLOSSY_DEPTH:
        value = integer[lane, POINT_GLOSSY_DEPTH]
    elif kind == LIGHT_PATH_TRANSMISSION_DEPTH:
        value = integer[lane, POINT_TRANSMISSION_DEPTH]
    elif kind == LIGHT_PATH_TRANSPARENT_DEPTH:
        value = integer[lane, POINT_TRANSPARENT_DEPTH]
    return np.float32(value)


@kernel
def is_of_world(points, lane):
    """Whether the background is looked at, whose places are directions."""
    return points.integer[lane, POINT_INSTANCE] < 0 and points.integer[lane, POINT_LIGHT] < 0


@kernel
def camera_coordinate(camera, points, lane, p):
    """Camera space (z forward) of world point `p`; for the background `p` is a direction."""
    if is_of_world(points, lane):
        p = add(p, (camera[CAMERA_TO_WORLD, 3], camera[CAMERA_TO_WORLD, 7], camera[CAMERA_TO_WORLD, 11]))
    return transform_point(camera, CAMERA_WORLD_TO_CAMERA, p)


@kernel
def window_coordinate(camera, points, lane, p):
    """Image coordinates in [0, 1] of world point `p`; for the background `p` is a direction.

    As in Cycles, an orthographic camera sees the background where its rays begin, and others that look there take the
    direction for a point.
    """
    kind = int(camera[CAMERA_LENS, CAMERA_KIND])
    is_world = is_of_world(points, lane)
    if kind == KIND_PANORAMA:
        if is_world:
            d = transform_direction(camera, CAMERA_WORLD_TO_CAMERA, p)
        else:
            d = transform_point(camera, CAMERA_WORLD_TO_CAMERA, p)
        x, y = panorama_window(camera[CAMERA_LENS], normalize((d[0], d[1], -d[2])))
        return np.float32(x), np.float32(y), np.float32(0.0)
    if is_world:
        if kind == KIND_PERSPECTIVE:
            p = add(p, (camera[CAMERA_TO_WORLD, 3], camera[CAMERA_TO_WORLD, 7], camera[CAMERA_TO_WORLD, 11]))
        elif points.integer[lane, POINT_RAY_FLAGS] & RAY_CAMERA:
            p = read_point(points, lane, POINT_TANGENT)
    h = transform_point(camera, CAMERA_WORLD_TO_NDC, p)
    if h[2] == 0.0:
        return (0.0 * h[2], 0.0 * h[2], 0.0 * h[2])
    return (h[0] / h[2], h[1] / h[2], 0.0 * h[2])


@kernel
def object_float(geometry, points, lane, pass_indices, kind):
    """A scalar of the Object Info node."""
    instance = points.integer[lane, POINT_INSTANCE]
    if kind == OBJECT_MATERIAL_INDEX:
        return pass_indices[points.integer[lane, POINT_PROGRAM]]
    if instance < 0:
        return 0.0
    if kind == OBJECT_INDEX:
        return np.float32(geometry.instance_table[instance, INSTANCE_PASS_INDEX])
    if kind == OBJECT_RANDOM:
        return geometry.instance_values[instance, 0]
    return geometry.instance_values[instance, 4]
