# SPDX-License-Identifier: GPL-3.0-or-later
"""Worlds that are one image: looked up without the interpreter, their texels asked for before.

Values are the interpreter's to the last bit.
"""

import numpy as np

from engine.kernels.prefetch import prefetch
from engine.kernels.shader.images import EXTENSION_REPEAT, image_color
from engine.kernels.shader.ops_image import PROJECTION_EQUIRECTANGULAR, environment_coordinates
from engine.kernels.shader.ops_input import table_transform
from engine.kernels.shader.surface import read_point
from engine.kernels.vector import normalize
from engine.runtime.jit import kernel
from engine.state.lanes import POINT_P, POINT_PROGRAM
from engine.state.shaders import (
    IMAGE_IS_FLOAT,
    IMAGE_OFFSET,
    IMAGE_X,
    IMAGE_Y,
    PROGRAM_WORLD_IMAGE,
    PROGRAM_WORLD_INTERPOLATION,
    PROGRAM_WORLD_TABLE,
    PROGRAM_WORLD_UNASSOCIATE,
    VALUE_WORLD,
)


@kernel
def _coordinates(programs, tables, points, lane, program):
    direction = read_point(points, lane, POINT_P)
    table = programs[program, PROGRAM_WORLD_TABLE]
    if table >= 0:
        direction = table_transform(tables, table, direction)
    return environment_coordinates(normalize(direction), PROJECTION_EQUIRECTANGULAR)


@kernel
def ask_for_world(programs, images, pixels_byte, pixels_float, tables, points, lane):
    """The texels that a lane's program will read, if that is a world of one image."""
    program = points.integer[lane, POINT_PROGRAM]
    if programs[program, PROGRAM_WORLD_IMAGE] == 0:
        return
    image = programs[program, PROGRAM_WORLD_IMAGE] - 1
    u, v = _coordinates(programs, tables, points, lane, program)
    width = images[image, IMAGE_X]
    height = images[image, IMAGE_Y]
    # Half a texel back: the filter's lower left one; and the row above.
    i = min(max(int(u * np.float32(width) - 0.5), 0), width - 1)
    j = min(max(int(v * np.float32(height) - 0.5), 0), height - 1)
    texel = images[image, IMAGE_OFFSET] + 4 * (j * width + i)
    for _row in range(2):
        if images[image, IMAGE_IS_FLOAT]:
            prefetch(pixels_float, texel)
        else:
            prefetch(pixels_byte, texel)
        texel += 4 * width


@kernel
def shade_world(programs, values, images, pixels_byte, pixels_float, tables, points, closures, lane):
    """Emission of a world of one image along the lane's direction."""
    program = points.integer[lane, POINT_PROGRAM]
    u, v = _coordinates(programs, tables, points, lane, program)
    color = image_color(
        images, pixels_byte, pixels_float, tables, programs[program, PROGRAM_WORLD_IMAGE] - 1, u, v,
        programs[program, PROGRAM_WORLD_INTERPOLATION], EXTENSION_REPEAT, programs[program, PROGRAM_WORLD_UNASSOCIATE],
    )
    factor = values[program, VALUE_WORLD]
    for c in range(3):
        closures.emission[lane, c] += factor * color[c]
