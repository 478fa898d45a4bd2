# SPDX-License-Identifier: GPL-3.0-or-later
"""What a bake looks at: a place on a mesh for each pixel, instead of what a camera sees."""

from __future__ import annotations

from dataclasses import dataclass

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
