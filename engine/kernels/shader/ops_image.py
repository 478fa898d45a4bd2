# SPDX-License-Identifier: GPL-3.0-or-later
"""Image and Environment Texture instructions: projections onto the image plane, then `images.image_color`."""

import math

from engine.kernels.angles import upper_angle
from engine.kernels.constants import INV_PI, INV_TWO_PI
from engine.kernels.memory import read3, write3
from engine.kernels.shader.images import find_tile, image_color
from engine.kernels.shader.opcodes import IMAGE_FIRST
from engine.kernels.vector import normalize
from engine.runtime.jit import kernel
from engine.state.shaders import IMAGE_TILE_COUNT

# color, alpha <- vector, object space normal, blend | image, projection, interpolation, extension, unassociate
OP_IMAGE = IMAGE_FIRST + 0
OP_ENVIRONMENT = IMAGE_FIRST + 1

PROJECTION_FLAT = 0
PROJECTION_BOX = 1
PROJECTION_SPHERE = 2
PROJECTION_TUBE = 3
PROJECTION_EQUIRECTANGULAR = 4
PROJECTION_MIRROR_BALL = 5


@kernel
def sphere_coordinates(x, y, z):
    """Longitude and latitude of (x, y, z) in [0, 1]^2, as Blender's sphere projection."""
    squared = x * x + y * y + z * z
    if not squared > 0.0:
        return 0.0, 0.0
    u = 0.0
    if x != 0.0 or y != 0.0:
        u = 0.5 - math.atan2(x, y) * INV_TWO_PI
    return u, 1.0 - math.acos(min(max(z / math.sqrt(squared), -1.0), 1.0)) * INV_PI


@kernel
def tube_coordinates(x, y, z):
    """Angle about z and height, as Blender's tube projection."""
    if x == 0.0 and y == 0.0:
        return 0.0, 0.0
    return 0.5 * (1.0 - math.atan2(x, y) * INV_PI), 0.5 * (z + 1.0)


@kernel
def environment_coordinates(d, projection):
    """Image coordinates of a unit direction."""
    if projection == PROJECTION_EQUIRECTANGULAR:
        if d[0] == 0.0 and d[1] == 0.0 and d[2] == 0.0:
            return 0.0, 0.0
        turn = upper_angle(abs(d[1]), d[0]) * INV_TWO_PI
        u = 0.5 + turn if d[1] < 0.0 else 0.5 - turn
        return u, 1.0 - upper_angle(math.sqrt(d[0] * d[0] + d[1] * d[1]), d[2]) * INV_PI
    y = d[1] - 1.0
    divisor = 2.0 * math.sqrt(max(-0.5 * y, 0.0))
    x = d[0]
    z = d[2]
    if divisor > 0.0:
        x /= divisor
        z /= divisor
    return 0.5 * (x + 1.0), 0.5 * (z + 1.0)


@kernel
def corner_weight(n, limit, a, b):
    """Whether axis value `n` outweighs both others so far that the box projection has one image only."""
    return n > limit * (n + a) and n > limit * (n + b)


@kernel
def edge_weight(a, b, blend):
    """Share of `a` between two images of the box projection."""
    return min(max((a / (a + b) - 0.5 * (1.0 - blend)) / blend, 0.0), 1.0)


@kernel
def box_weights(n, blend):
    """Weights of the images along x, y and z for object normal `n`: single in the corners, blended in between."""
    x = abs(n[0])
    y = abs(n[1])
    z = abs(n[2])
    total = x + y + z
    x /= total
    y /= total
    z /= total
    limit = 0.5 * (1.0 + blend)
    one = 1.0
    zero = 0.0
    if corner_weight(x, limit, y, z):
        return one, zero, zero
    if corner_weight(y, limit, x, z):
        return zero, one, zero
    if corner_weight(z, limit, x, y):
        return zero, zero, one
    if not blend > 0.0:
        return one, zero, zero
    if z < (1.0 - limit) * (y + x):
        w = edge_weight(x, y, blend)
        return w, 1.0 - w, zero
    if x < (1.0 - limit) * (y + z):
        w = edge_weight(y, z, blend)
        return zero, w, 1.0 - w
    if y < (1.0 - limit) * (x + z):
        w = edge_weight(x, z, blend)
        return w, zero, 1.0 - w
    scale = 1.0 / (2.0 * limit - 1.0)
    offset = limit - 1.0
    slope = 2.0 - limit
    return (slope * x + offset) * scale, (slope * y + offset) * scale, (slope * z + offset) * scale


@kernel
def run_image_op(opcode, code, pc, memory, images, pixels_byte, pixels_float, tables):
    """Run the instruction at `pc`. One loop over the (up to three, for box) lookups: the filter is compiled once."""
    p = read3(memory, code[pc + 4])
    image = code[pc + 7]
    projection = code[pc + 8]
    u = p[0]
    v = p[1]
    weights = (1.0, 0.0, 0.0)
    lookups = 1
    n = p
    if projection == PROJECTION_BOX:
        n = read3(memory, code[pc + 5])
        weights = box_weights(n, memory[code[pc + 6]])
        lookups = 3
    elif projection == PROJECTION_SPHERE:
        u, v = sphere_coordinates(2.0 * p[0] - 1.0, 2.0 * p[1] - 1.0, 2.0 * p[2] - 1.0)
    elif projection == PROJECTION_TUBE:
        u, v = tube_coordinates(2.0 * p[0] - 1.0, 2.0 * p[1] - 1.0, 2.0 * p[2] - 1.0)
    elif projection >= PROJECTION_EQUIRECTANGULAR:
        u, v = environment_coordinates(normalize(p), projection)
    r = 0.0
    g = 0.0
    b = 0.0
    a = 0.0
    for k in range(lookups):
        weight = weights[k]
        if weight > 0.0:
            if projection == PROJECTION_BOX:
                # No image is mirrored on any side of the box.
                if k == 0:
                    u = 1.0 - p[1] if n[0] < 0.0 else p[1]
                    v = p[2]
                elif k == 1:
                    u = 1.0 - p[0] if n[1] > 0.0 else p[0]
                    v = p[2]
                else:
                    u = 1.0 - p[1] if n[2] > 0.0 else p[1]
                    v = p[0]
            row = image
            if image >= 0 and images[image, IMAGE_TILE_COUNT] > 0:
                row, u, v = find_tile(images, image, u, v)
            c = image_color(
                images, pixels_byte, pixels_float, tables, row, u, v, code[pc + 9], code[pc + 10], code[pc + 11]
            )
            r += weight * c[0]
            g += weight * c[1]
            b += weight * c[2]
            a += weight * c[3]
    write3(memory, code[pc + 2], (r, g, b))
    memory[code[pc + 3]] = a
