# SPDX-License-Identifier: GPL-3.0-or-later
"""Places of a bake, and the rays that look at them."""

import numpy as np

from engine.kernels.constants import INFINITY
from engine.kernels.rng import SET_FILTER_LENS, hash_combine, sample_4d, unit_float
from engine.kernels.vector import add, dot, normalize, scale, subtract
from engine.runtime.jit import kernel
from engine.state.bake import (
    BAKE_EYE,
    BAKE_VIEW,
    PLACE_DU_DX,
    PLACE_DU_DY,
    PLACE_DV_DX,
    PLACE_DV_DY,
    PLACE_U,
    PLACE_V,
    VIEW_ABOVE,
    VIEW_DIRECTION,
)

#: Draws of a place within a pixel before its centre is taken.
_DRAWS = 10
#: The least cosine between the shading normal and the direction to the camera: what faces away from the camera is seen
#: as if by grazing, so that glossy surfaces are not black there. Cycles' own.
_LEAST_COSINE = np.float32(0.2)
#: The same of the geometric normal, so that no place is seen from behind.
_LEAST_TRUE_COSINE = np.float32(1e-5)
#: How far before a place a ray begins, in bounds on the place's rounding error.
_ERRORS = np.float32(2.0)


@kernel
def draw_place(bake, row, rng, sample):
    """Where a sample looks at in its pixel: barycentrics (u, v) as hits have them.

    Within the pixel evenly, and never on the edge of the pixel's triangle or beside: a draw there is drawn again. The
    first sample looks at the centre, unless that is at the edge: from Blender 5.3 on pixels that a triangle only
    touches have the nearest place of it. All as in Cycles.

    Parameters
    ----------
    bake : BakeArrays
    row : int, of `bake.places`
    rng : uint32; sample : int
    """
    places = bake.places
    u, v = places[row, PLACE_U], places[row, PLACE_V]
    x, y, _, _ = sample_4d(rng, sample, SET_FILTER_LENS)
    if sample == 0:
        x = y = np.float32(0.5)
    bits = hash_combine(rng, np.uint32(sample))
    for _ in range(_DRAWS):
        x -= 0.5
        y -= 0.5
        moved_u = u + x * places[row, PLACE_DU_DX] + y * places[row, PLACE_DU_DY]
        moved_v = v + x * places[row, PLACE_DV_DX] + y * places[row, PLACE_DV_DY]
        if moved_u > 0.0 and moved_v > 0.0 and moved_u + moved_v < 1.0:
            u, v = moved_u, moved_v
            break
        bits = hash_combine(bits, np.uint32(1))
        x = unit_float(bits)
        bits = hash_combine(bits, np.uint32(2))
        y = unit_float(bits)
    # Blender weighs the first two corners, hits the last two.
    return v, 1.0 - u - v


@kernel
def direction_to_view(bake, p, ng, ns):
    """Unit vector from a place to where it is seen from.

    Parameters
    ----------
    bake : BakeArrays, whose view is of places
    p, ng, ns : 3-tuples, world [m], unit, unit
    """
    view = bake.header[BAKE_VIEW]
    if view == VIEW_ABOVE:
        return ns
    numbers = bake.numbers
    eye = (numbers[BAKE_EYE], numbers[BAKE_EYE + 1], numbers[BAKE_EYE + 2])
    towards = eye if view == VIEW_DIRECTION else normalize(subtract(eye, p))
    cosine = dot(towards, ns)
    if cosine <= _LEAST_COSINE:
        towards = normalize(subtract(towards, scale(ns, cosine - _LEAST_COSINE)))
    if cosine <= 0.0:
        # The farther behind, the more it is seen from above.
        towards = normalize(add(scale(towards, 1.0 + cosine), scale(ns, -cosine)))
    true_cosine = dot(towards, ng)
    if true_cosine <= _LEAST_TRUE_COSINE:
        towards = normalize(subtract(towards, scale(ng, true_cosine - _LEAST_TRUE_COSINE)))
    return towards


@kernel
def ray_to_background(p):
    """Origin, direction and length of the ray that looks for the background in the direction in which p lies."""
    direction = normalize(p)
    if dot(direction, direction) < 0.5:
        direction = (0.0, 0.0, 1.0)
    return (0.0, 0.0, 0.0), direction, INFINITY


@kernel
def ray_to_place(bake, p, ng, ns, error):
    """Origin and direction of the ray that looks at a place, and how far away that is [m].

    It begins so near that nothing lies between but what is in the same place; `meet_baked` says what it meets.
    """
    towards = direction_to_view(bake, p, ng, ns)
    distance = _ERRORS * error
    return add(p, scale(towards, distance)), scale(towards, -1.0), distance
