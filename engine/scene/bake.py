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


@dataclass
class Bake:
    """The places of a bake, H x W pixels, row 0 at the bottom; the frame has as many.

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
    """

    instance: int
    triangles: Int32Array
    weights: Float32Array
    differentials: Float32Array
    seeds: Int32Array | None = None
    view: str = FROM_ABOVE

    @property
    def has_places(self) -> bool:
        """Whether any pixel has something to look at."""
        return bool((self.triangles >= 0).any())

    @property
    def region(self) -> tuple[int, int, int, int]:
        """The smallest rectangle that all places are in: (x0, y0, x1, y1), y from the bottom; there is a place."""
        is_covered = self.triangles >= 0
        (columns,), (rows,) = np.nonzero(is_covered.any(axis=0)), np.nonzero(is_covered.any(axis=1))
        return int(columns[0]), int(rows[0]), int(columns[-1]) + 1, int(rows[-1]) + 1
