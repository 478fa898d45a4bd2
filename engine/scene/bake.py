# SPDX-License-Identifier: GPL-3.0-or-later
"""What a bake looks at: a place on a mesh for each pixel, instead of what a camera sees."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from engine.array_types import Float32Array, Int32Array

#: From where each place is looked at: along its normal, from the scene's camera, or not at all: what is looked at is
#: the background, in the direction in which the place lies from the world's origin.
FROM_ABOVE = "ABOVE"
FROM_CAMERA = "CAMERA"
BACKGROUND = "BACKGROUND"

#: Texels of the largest image that is baked as a whole, and of a band of larger ones.
MOST_AT_ONCE, BAND_TEXELS = 1 << 24, 1 << 23


@dataclass
class Bake:
    """The places of a bake, H x W pixels, row 0 at the bottom: those of the frame's rows that are rendered, or more.

    Attributes
    ----------
    instance : int
        Row of `SceneDescription.instances` that all places are on.
    triangles : int32 (H, W)
        Row of `Mesh.triangles` of its mesh, -1 = no place, and nothing to look at.
    weights : float32 (H, W, 2)
        Of the first and second corner of the triangle, at the pixel's centre.
    differentials : float32 (H, W, 4)
        By how much the first weight changes over a pixel's width and height, then the second.
    seeds : int32 (H, W) or None
        Pixels of one number draw the same random numbers; None: each its own.
    view : str
        FROM_ABOVE, FROM_CAMERA or BACKGROUND.
    first_row : int
        Row of the frame that row 0 is.
    """

    instance: int
    triangles: Int32Array
    weights: Float32Array
    differentials: Float32Array
    seeds: Int32Array | None = None
    view: str = FROM_ABOVE
    first_row: int = 0

    @property
    def region(self) -> tuple[int, int, int, int]:
        """The smallest rectangle of the frame that all places are in: (x0, y0, x1, y1), y from the bottom; there is a
        place.
        """
        is_covered = self.triangles >= 0
        (columns,), (rows,) = np.nonzero(is_covered.any(axis=0)), np.nonzero(is_covered.any(axis=1))
        bottom, top = int(rows[0]) + self.first_row, int(rows[-1]) + 1 + self.first_row
        return int(columns[0]), bottom, int(columns[-1]) + 1, top


def bands_of(width: int, height: int) -> list[tuple[int, int]]:
    """First and last row, this one excluded, of the bands that an image is baked in, from the bottom.

    What is held of a texel while it is rendered is several times what its pixel is. So images are baked as a whole only
    as far as that is little.
    """
    most = height if width * height <= MOST_AT_ONCE else max(BAND_TEXELS // width, 1)
    return [(first, min(first + most, height)) for first in range(0, height, most)]
