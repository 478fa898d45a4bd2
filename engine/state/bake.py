# SPDX-License-Identifier: GPL-3.0-or-later
"""The places of a bake as kernels read them."""

from __future__ import annotations

import numpy as np

from engine.array_types import Float32Array, Int32Array, Int64Array
from engine.runtime.bundle import Bundle

# BakeArrays.header
BAKE_INSTANCE = 0
BAKE_IMAGE_WIDTH = 1
BAKE_VIEW = 2  # VIEW_*
BAKE_FIRST_ROW = 3  # of the full image, that `BakeArrays.rows` begins with
BAKE_HEADER_WIDTH = 4

VIEW_ABOVE = 0
VIEW_POINT = 1  # from BAKE_EYE
VIEW_DIRECTION = 2  # from far away in the direction BAKE_EYE
VIEW_BACKGROUND = 3  # of the background, in the direction in which the place lies

# BakeArrays.numbers
BAKE_EYE = 0  # 3, world
BAKE_DISTANCE = 3  # [m] from which all that is baked would be seen
BAKE_NUMBERS = 4

# Columns of BakeArrays.places
PLACE_U = 0  # weights of the first and second corner, at the pixel's centre
PLACE_V = 1
PLACE_DU_DX = 2  # by how much they change over a pixel
PLACE_DU_DY = 3
PLACE_DV_DX = 4
PLACE_DV_DY = 5
PLACE_RADIUS = 6  # [m] of the pixel on the surface, as a compact ray differential
PLACE_WIDTH = 7


class BakeArrays(Bundle):
    """Places to look at, R of them; where nothing is baked there is none.

    header : int64 (BAKE_HEADER_WIDTH,)
    numbers : float32 (BAKE_NUMBERS,)
    rows : int32 (P,), of each pixel of some of the full image's rows its place, -1 = none
    places : float32 (R, PLACE_WIDTH)
    triangles : int32 (R,), rows of `GeometryArrays.triangles`
    seeds : int32 (R,) or (0,): each pixel has random numbers of its own
    """

    header: Int64Array
    numbers: Float32Array
    rows: Int32Array
    places: Float32Array
    triangles: Int32Array
    seeds: Int32Array


def no_bake() -> BakeArrays:
    """`BakeArrays` of scenes that a camera looks at."""
    return BakeArrays(
        header=np.zeros(BAKE_HEADER_WIDTH, np.int64),
        numbers=np.zeros(BAKE_NUMBERS, np.float32),
        rows=np.zeros(0, np.int32),
        places=np.zeros((0, PLACE_WIDTH), np.float32),
        triangles=np.zeros(0, np.int32),
        seeds=np.zeros(0, np.int32),
    )
