# SPDX-License-Identifier: GPL-3.0-or-later
"""A point within media as stages of light and scattering meet it: phase functions as closures, and no normal."""

import numpy as np

from engine.kernels.bsdf.phase import add_phase
from engine.kernels.vector import add, load, scale
from engine.runtime.jit import kernel
from engine.state.lanes import (
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
from engine.state.media import LOBE_ALPHA, LOBE_G, LOBE_SCATTERING, MEDIUM_SCATTERING

#: Length of the normal that the light tree is given: so long that no direction is at a slant to it, for a medium
#: receives light from all around.
_NORMAL_LENGTH = np.float32(1e6)


@kernel
def all_around(direction):
    """The normal by which the light tree takes every direction for one that the receiver faces."""
    return scale(direction, _NORMAL_LENGTH)


@kernel
def add_lobes(scene, closures, media, lane):
    """Append the phase functions of all that a path is in, each by its share in what the collision scatters."""
    arrays = scene.media
    closures.count[lane] = 0
    closures.flags[lane] = 0
    for k in range(media.count[lane]):
        medium = media.medium[lane, k]
        for row in range(arrays.first_lobe[medium], arrays.first_lobe[medium + 1]):
            mine = 0.0
            for c in range(RGB):
                mine += arrays.lobes[row, LOBE_SCATTERING + c]
            all_media = 0.0
            for other in range(media.count[lane]):
                for c in range(RGB):
                    all_media += arrays.media[media.medium[lane, other], MEDIUM_SCATTERING + c]
            share = mine / all_media if all_media > 0.0 else 0.0
            if not share > 0.0:
                continue
            i = add_phase(closures, lane, share, arrays.lobes[row, LOBE_G], arrays.lobes[row, LOBE_ALPHA])
            # At wavelengths the shares of the whole have to do.
            if len(closures.channels) > RGB or i < 0:
                continue
            for c in range(RGB):
                total = 0.0
                for other in range(media.count[lane]):
                    total += arrays.media[media.medium[lane, other], MEDIUM_SCATTERING + c]
                of_channel = arrays.lobes[row, LOBE_SCATTERING + c] / total if total > 0.0 else 0.0
                closures.param[lane, i, CLOSURE_WEIGHT + c] = of_channel


@kernel
def place_collision(paths, points, lane, distance):
    """Set up a point on a path's ray, within media; its phase functions are `add_lobes`' business."""
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
