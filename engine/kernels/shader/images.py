# SPDX-License-Identifier: GPL-3.0-or-later
"""Looking up images: extension, interpolation and colour exactly as Cycles' CPU kernels have them.

Texel (i, j) is centred at ((i + 0.5) / width, (j + 0.5) / height), row 0 at the bottom. Filtering happens on stored
values; alpha is divided out and sRGB decoded afterwards.
"""


import numpy as np

from engine.kernels.rounding import floor_of
from engine.kernels.shader.four import blend_four
from engine.runtime.jit import kernel
from engine.state.shaders import (
    IMAGE_IS_FLOAT,
    IMAGE_IS_SRGB,
    IMAGE_OFFSET,
    IMAGE_TILE_COUNT,
    IMAGE_TILE_FIRST,
    IMAGE_X,
    IMAGE_Y,
    SRGB_TABLE_SIZE,
    TILE_IMAGE,
    TILE_NUMBER,
)

INTERPOLATION_LINEAR = 0
INTERPOLATION_CLOSEST = 1
INTERPOLATION_CUBIC = 2

EXTENSION_REPEAT = 0
EXTENSION_EXTEND = 1
EXTENSION_CLIP = 2
EXTENSION_MIRROR = 3

FIRST_TILE = 1001
TILES_IN_A_ROW = 10
MOST_TILE_ROWS = 1000

_LAST_SRGB = np.float32(SRGB_TABLE_SIZE - 1)
_INV_255 = np.float32(1.0 / 255.0)
_ONE = np.float32(1.0)


@kernel
def wrap(i, size, extension):
    """Texel index brought into the image; -1 = outside it (clip)."""
    if 0 <= i < size:
        return i
    if extension == EXTENSION_REPEAT:
        return i % size
    if extension == EXTENSION_EXTEND:
        return 0 if i < 0 else size - 1
    if extension == EXTENSION_MIRROR:
        m = (-i - 1 if i < 0 else i) % (2 * size)
        return m if m < size else 2 * size - m - 1
    return -1


@kernel
def texel(images, pixels_byte, pixels_float, image, i, j, weight):
    """Stored RGBA times `weight`; zero where an index is -1."""
    if i < 0 or j < 0:
        return (0.0, 0.0, 0.0, 0.0)
    at = images[image, IMAGE_OFFSET] + 4 * (j * images[image, IMAGE_X] + i)
    if images[image, IMAGE_IS_FLOAT]:
        return (
            weight * pixels_float[at],
            weight * pixels_float[at + 1],
            weight * pixels_float[at + 2],
            weight * pixels_float[at + 3],
        )
    weight *= _INV_255
    return (
        weight * np.float32(pixels_byte[at]),
        weight * np.float32(pixels_byte[at + 1]),
        weight * np.float32(pixels_byte[at + 2]),
        weight * np.float32(pixels_byte[at + 3]),
    )


@kernel
def _blend(pixels, first, second, third, fourth, x, y, whole):
    """RGBA of four texels, given by the indices of their reds: left and right ones of the lower and upper row.

    `x` in [0, 1] is the share of the right ones, `y` in [0, whole] that of the upper ones.
    """
    left = 1.0 - x
    low = whole - y
    return blend_four(pixels, first, second, third, fourth, left * low, x * low, left * y, x * y)


@kernel
def cubic_weight(t, k):
    """Weight of tap `k` (0..3, at -1..2) of the uniform cubic B-spline at fraction `t`."""
    if k == 0:
        return ((-(1.0 / 6.0) * t + 0.5) * t - 0.5) * t + (1.0 / 6.0)
    if k == 1:
        return (0.5 * t - 1.0) * t * t + (2.0 / 3.0)
    if k == 2:
        return ((-0.5 * t + 0.5) * t + 0.5) * t + (1.0 / 6.0)
    return (1.0 / 6.0) * t * t * t


@kernel
def filtered(images, pixels_byte, pixels_float, image, u, v, interpolation, extension):
    """Filtered stored RGBA at (u, v)."""
    width = images[image, IMAGE_X]
    height = images[image, IMAGE_Y]
    x = u * np.float32(width)
    y = v * np.float32(height)
    # A NaN or huge coordinate must not become an index.
    if not (abs(x) < 1e9 and abs(y) < 1e9):
        return (0.0, 0.0, 0.0, 0.0)
    if interpolation == INTERPOLATION_CLOSEST:
        i = wrap(floor_of(x), width, extension)
        j = wrap(floor_of(y), height, extension)
        return texel(images, pixels_byte, pixels_float, image, i, j, 1.0)
    x -= 0.5
    y -= 0.5
    i = floor_of(x)
    j = floor_of(y)
    x -= np.float32(i)
    y -= np.float32(j)
    taps = 2
    if interpolation == INTERPOLATION_CUBIC:
        taps = 4
        i -= 1
        j -= 1
    else:
        left = wrap(i, width, extension)
        low = wrap(j, height, extension)
        if extension == EXTENSION_REPEAT:
            # Without another division each.
            right = left + 1 if left + 1 < width else 0
            high = low + 1 if low + 1 < height else 0
        else:
            right = wrap(i + 1, width, extension)
            high = wrap(j + 1, height, extension)
        if left >= 0 and right >= 0 and low >= 0 and high >= 0:
            below = images[image, IMAGE_OFFSET] + 4 * low * width
            above = below + 4 * (high - low) * width
            left *= 4
            right *= 4
            if images[image, IMAGE_IS_FLOAT]:
                return _blend(pixels_float, below + left, below + right, above + left, above + right, x, y, _ONE)
            y *= _INV_255
            return _blend(pixels_byte, below + left, below + right, above + left, above + right, x, y, _INV_255)
    r = 0.0
    g = 0.0
    b = 0.0
    a = 0.0
    for row in range(taps):
        weight_y = cubic_weight(y, row) if taps == 4 else (y if row == 1 else 1.0 - y)
        jj = wrap(j + row, height, extension)
        for column in range(taps):
            weight_x = cubic_weight(x, column) if taps == 4 else (x if column == 1 else 1.0 - x)
            ii = wrap(i + column, width, extension)
            t = texel(images, pixels_byte, pixels_float, image, ii, jj, weight_x * weight_y)
            r += t[0]
            g += t[1]
            b += t[2]
            a += t[3]
    return (r, g, b, a)


@kernel
def _table_to_linear(tables, c):
    """Decode an sRGB value by the table: one in [0, 1], but for rounding."""
    x = c * _LAST_SRGB
    i = min(int(x), SRGB_TABLE_SIZE - 2)
    t = x - np.float32(i)
    return tables[i] + t * (tables[i + 1] - tables[i])


@kernel
def srgb_to_linear(tables, c):
    """Decode an sRGB value; a table on [0, 1], the formula beyond (IEC 61966-2-1)."""
    if c <= 0.0:
        return c * (1.0 / 12.92)
    # Filtered bytes are above 1 by rounding, where the table's last piece goes on as well.
    if c >= 1.0001:
        return ((c + 0.055) / 1.055) ** 2.4
    return _table_to_linear(tables, c)


@kernel
def find_tile(images, image, u, v):
    """The tile of an image in which (u, v) lies.

    Returns
    -------
    image : int, row of the tile, -1 where there is none; u, v : within it
    """
    if not (-1.0 < u < TILES_IN_A_ROW and -1.0 < v < MOST_TILE_ROWS):
        return -1, u, v
    # Cut off, not rounded down, as in Cycles: the first column and row go on to -1, as the extension says.
    column = int(u)
    row = int(v)
    number = FIRST_TILE + TILES_IN_A_ROW * row + column
    first = images[image, IMAGE_TILE_FIRST]
    for k in range(first, first + images[image, IMAGE_TILE_COUNT]):
        if images[k, TILE_NUMBER] == number:
            return images[k, TILE_IMAGE], u - np.float32(column), v - np.float32(row)
    return -1, u, v


@kernel
def image_color(images, pixels_byte, pixels_float, tables, image, u, v, interpolation, extension, unassociate):
    """RGBA of an image at (u, v), scene-linear; Cycles' magenta for a missing image (-1)."""
    if image < 0:
        return (1.0, 0.0, 1.0, 1.0)
    r, g, b, a = filtered(images, pixels_byte, pixels_float, image, u, v, interpolation, extension)
    if unassociate != 0 and a != 1.0 and a != 0.0:
        r /= a
        g /= a
        b /= a
    elif images[image, IMAGE_IS_SRGB] and not images[image, IMAGE_IS_FLOAT]:
        # Filtered bytes.
        return _table_to_linear(tables, r), _table_to_linear(tables, g), _table_to_linear(tables, b), a
    if images[image, IMAGE_IS_SRGB]:
        r = srgb_to_linear(tables, r)
        g = srgb_to_linear(tables, g)
        b = srgb_to_linear(tables, b)
    return (r, g, b, a)
