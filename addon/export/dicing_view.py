# SPDX-License-Identifier: GPL-3.0-or-later
"""From where edges of meshes are measured that are to be diced, and what is seen that is to be culled."""

from __future__ import annotations

import math
from dataclasses import dataclass

import bpy
import numpy as np
import numpy.typing as npt


@dataclass(frozen=True, eq=False)
class DicingView:
    """From where edges of meshes are measured.

    to_camera : float64 (4, 4), from the world
    projection : float64 (4, 4), as Blender has it; unused of panoramas
    kind : str, 'PERSP', 'ORTHO' or 'PANO'
    width, height : int, of the picture [pixels]
    nearest, farthest : float, distances between which something is seen
    """

    to_camera: npt.NDArray[np.float64]
    projection: npt.NDArray[np.float64]
    kind: str
    width: int
    height: int
    nearest: float
    farthest: float

    @classmethod
    def of_camera(cls, depsgraph: bpy.types.Depsgraph, camera: bpy.types.Object, width: int, height: int) -> DicingView:
        """That of an evaluated object in a picture of this size."""
        render = depsgraph.scene_eval.render
        projection = camera.calc_matrix_camera(
            depsgraph, x=width, y=height, scale_x=render.pixel_aspect_x, scale_y=render.pixel_aspect_y
        )
        return cls(
            np.array(camera.matrix_world.normalized().inverted_safe(), np.float64), np.array(projection, np.float64),
            camera.data.type if camera.type == "CAMERA" else "PERSP", width, height,
            max(getattr(camera.data, "clip_start", 0.1), 1e-6), getattr(camera.data, "clip_end", 1000.0),
        )  # fmt: skip

    @property
    def pixel(self) -> float:
        """Size of a pixel, one length ahead of the camera."""
        if self.kind == "PANO":
            return 2.0 * math.pi / self.width
        return 2.0 / (max(abs(float(self.projection[0, 0])), 1e-12) * self.width)
