# SPDX-License-Identifier: GPL-3.0-or-later
"""A point within media as stages of light and scattering meet it: phase functions as closures, and no normal."""

import numpy as np

from engine.kernels.bsdf.phase import add_phase
from engine.kernels.vector import add, load, scale
from engine.runtime.jit import kernel
from engine.state.lanes import (
    CLOSURE_SAMPLE_WEIGHT,
    CLOSURE_WEIGHT,
    POINT_INSTANCE,
    POINT_NG,
    POINT_NS,
    POINT_P,
    POINT_PROGRAM,
    POINT_RADIUS,
    POINT_WO,
    RGB,
)
from engine.state.media import LOBE_ALPHA, LOBE_DELTA, LOBE_G, LOBE_SCATTERING

#: Length of the normal that the light tree is given: so long that no direction is at a slant to it, for a medium
#: receives light from all around.
_NORMAL_LENGTH = np.float32(1e6)


@kernel
def all_around(direction):
    """The normal by which the light tree takes every direction for one that the receiver faces."""
    return scale(direction, _NORMAL_LENGTH)


@kernel
def add_uniform_lobes(arrays, closures, lane, medium):
    """Append the phase functions of a medium that is the same everywhere, by what each scatters [m^-1]."""
    for row in range(arrays.first_lobe[medium], arrays.first_lobe[medium + 1]):
        mean = 0.0
        for c in range(RGB):
            mean += arrays.lobes[row, LOBE_SCATTERING + c] * (1.0 / 3.0)
        if not mean > 0.0:
            continue
        lobes = arrays.lobes
        i = add_phase(closures, lane, mean, lobes[row, LOBE_G], lobes[row, LOBE_ALPHA], lobes[row, LOBE_DELTA])
        if i >= 0:
            for c in range(RGB):
                closures.param[lane, i, CLOSURE_WEIGHT + c] = arrays.lobes[row, LOBE_SCATTERING + c]


@kernel
def share_out(closures, lane):
    """Give phase functions, whose weights are what each scatters [m^-1], their shares of all of it by channel."""
    param, count = closures.param, closures.count[lane]
    if count == 1:
        param[lane, 0, CLOSURE_SAMPLE_WEIGHT] = 1.0
        for c in range(RGB):
            param[lane, 0, CLOSURE_WEIGHT + c] = 1.0 if param[lane, 0, CLOSURE_WEIGHT + c] > 0.0 else 0.0
        if len(closures.channels) > RGB:
            for c in range(len(closures.channels)):
                param[lane, 0, CLOSURE_WEIGHT + c] = 1.0
        return
    total = 0.0
    for i in range(count):
        total += param[lane, i, CLOSURE_SAMPLE_WEIGHT]
    for c in range(RGB):
        of_channel = 0.0
        for i in range(count):
            of_channel += param[lane, i, CLOSURE_WEIGHT + c]
        for i in range(count):
            weight = param[lane, i, CLOSURE_WEIGHT + c]
            param[lane, i, CLOSURE_WEIGHT + c] = weight / of_channel if of_channel > 0.0 else 0.0
    for i in range(count):
        share = param[lane, i, CLOSURE_SAMPLE_WEIGHT] / total if total > 0.0 else 0.0
        param[lane, i, CLOSURE_SAMPLE_WEIGHT] = share
        # At wavelengths the shares of the whole have to do.
        if len(closures.channels) > RGB:
            for c in range(len(closures.channels)):
                param[lane, i, CLOSURE_WEIGHT + c] = share


@kernel
def set_lobes(scene, closures, media, lane):
    """Set the closures to the phase functions of all that a path is in, each by its share in what is scattered."""
    closures.count[lane] = 0
    closures.flags[lane] = 0
    for entry in range(media.count[lane]):
        add_uniform_lobes(scene.media, closures, lane, media.medium[lane, entry])
    share_out(closures, lane)


@kernel
def place_collision(paths, points, lane, distance):
    """Set up a point on a path's ray, within media; its phase functions are `set_lobes`' business."""
    direction = load(paths.direction, lane)
    p = add(load(paths.origin, lane), scale(direction, distance))
    normal = all_around(direction)
    real, integer = points.real, points.integer
    for c in range(3):
        real[lane, POINT_P + c] = p[c]
        real[lane, POINT_WO + c] = -direction[c]
        # No side is the wrong one.
        real[lane, POINT_NG + c] = 0.0
        real[lane, POINT_NS + c] = normal[c]
    real[lane, POINT_RADIUS] = paths.radius[lane] + distance * paths.spread[lane]
    integer[lane, POINT_INSTANCE] = -1
    integer[lane, POINT_PROGRAM] = -1
    paths.offset[lane] = 0.0


@kernel
def scatter_throughput(paths, lane, f_cos, factor):
    """Multiply a path's throughput by row `lane` of `f_cos` times a factor; the row gets what it was before.

    Returns
    -------
    float32
        The largest channel; 0: the path has no light left.
    """
    largest = 0.0
    for c in range(len(paths.channels)):
        before = paths.throughput[lane, c]
        value = before * f_cos[lane, c] * factor
        f_cos[lane, c] = before
        paths.throughput[lane, c] = value
        largest = max(largest, abs(value))
    return largest
