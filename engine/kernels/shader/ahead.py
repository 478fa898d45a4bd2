# SPDX-License-Identifier: GPL-3.0-or-later
"""Asking for texels some lanes before their program runs: a texture fits into no cache, and waiting for it was a third
of the time of textured surfaces.

What will be read is foreseen for a program's first flat image whose coordinates are a UV map as it is; nothing depends
on getting it right.
"""


import numpy as np

from engine.kernels.prefetch import prefetch
from engine.kernels.rounding import floor_of
from engine.kernels.shader.ops_input import default_slot
from engine.runtime.jit import kernel
from engine.state.geometry import (
    ATTRIBUTE_COMPONENTS,
    ATTRIBUTE_DOMAIN,
    ATTRIBUTE_OFFSET,
    DOMAIN_CORNER,
    INSTANCE_MESH,
    MESH_DEFAULT_UV,
    MESH_FIRST_TRIANGLE,
)
from engine.state.lanes import POINT_INSTANCE, POINT_PROGRAM, POINT_TRIANGLE, POINT_U, POINT_V
from engine.state.shaders import IMAGE_IS_FLOAT, IMAGE_OFFSET, IMAGE_X, IMAGE_Y, PROGRAM_AHEAD_IMAGE, PROGRAM_AHEAD_SLOT


@kernel
def _corner_coordinates(programs, geometry, points, lane):
    """Where in `attribute_data` the UVs of a point's corners begin and how many floats each has; -1 = not foreseen."""
    instance = points.integer[lane, POINT_INSTANCE]
    program = points.integer[lane, POINT_PROGRAM]
    if instance < 0 or programs[program, PROGRAM_AHEAD_IMAGE] == 0:
        return -1, 0
    slot = programs[program, PROGRAM_AHEAD_SLOT]
    if slot < 0:
        slot = default_slot(geometry, instance, MESH_DEFAULT_UV)
        if slot < 0:
            return -1, 0
    mesh = geometry.instance_table[instance, INSTANCE_MESH]
    row = mesh * geometry.attribute_count[0] + slot
    components = geometry.attribute_table[row, ATTRIBUTE_COMPONENTS]
    if geometry.attribute_table[row, ATTRIBUTE_DOMAIN] != DOMAIN_CORNER or components < 2:
        return -1, 0
    triangle = points.integer[lane, POINT_TRIANGLE] - geometry.mesh_table[mesh, MESH_FIRST_TRIANGLE]
    return geometry.attribute_table[row, ATTRIBUTE_OFFSET] + 3 * components * triangle, components


@kernel
def ask_for_coordinates(programs, geometry, points, lane):
    """The UVs that the texels to ask for follow from."""
    at, _components = _corner_coordinates(programs, geometry, points, lane)
    if at >= 0:
        prefetch(geometry.attribute_data, at)


@kernel
def ask_for_texels(programs, images, pixels_byte, pixels_float, geometry, points, lane):
    """The texels around a point's UV, as if the image were repeated."""
    at, components = _corner_coordinates(programs, geometry, points, lane)
    if at < 0:
        return
    data = geometry.attribute_data
    b = points.real[lane, POINT_U]
    c = points.real[lane, POINT_V]
    a = 1.0 - b - c
    u = a * data[at] + b * data[at + components] + c * data[at + 2 * components]
    v = a * data[at + 1] + b * data[at + components + 1] + c * data[at + 2 * components + 1]
    if not (abs(u) < 1e6 and abs(v) < 1e6):
        return
    image = programs[points.integer[lane, POINT_PROGRAM], PROGRAM_AHEAD_IMAGE] - 1
    width = images[image, IMAGE_X]
    height = images[image, IMAGE_Y]
    # The filter's lower left texel, half a texel back, and the one above.
    i = int((u - np.float32(floor_of(u))) * np.float32(width) - 0.5)
    j = floor_of((v - np.float32(floor_of(v))) * np.float32(height) - 0.5)
    texel = images[image, IMAGE_OFFSET] + 4 * (j * width + i)
    for _row in range(2):
        if images[image, IMAGE_IS_FLOAT]:
            prefetch(pixels_float, texel)
        else:
            prefetch(pixels_byte, texel)
        texel += 4 * width
