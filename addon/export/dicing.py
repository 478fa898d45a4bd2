# SPDX-License-Identifier: GPL-3.0-or-later
"""How finely Cycles would dice a mesh: by the size of a pixel at its vertices, or by a length in its own space."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import bpy
import numpy as np
import numpy.typing as npt

from engine.scene.dicing import Dicing

from .context import ExportContext, cycles_property

#: Cycles takes no lower rate than this many pixels.
_LEAST_PIXELS = 0.1


@dataclass(frozen=True, eq=False)
class DicingView:
    """From where edges of meshes are measured.

    to_camera : float64 (4, 4), from the world
    projection : float64 (4, 4), as Blender has it; unused of panoramas
    kind : str, 'PERSP', 'ORTHO' or 'PANO'
    width, height : int, of the picture [pixels]
    nearest : float, distance before which nothing is seen
    """

    to_camera: npt.NDArray[np.float64]
    projection: npt.NDArray[np.float64]
    kind: str
    width: int
    height: int
    nearest: float

    @classmethod
    def of_camera(cls, context: ExportContext, camera: bpy.types.Object, width: int, height: int) -> DicingView:
        """That of an evaluated object in a picture of this size."""
        render = context.scene.render
        projection = camera.calc_matrix_camera(
            context.depsgraph, x=width, y=height, scale_x=render.pixel_aspect_x, scale_y=render.pixel_aspect_y
        )
        return cls(
            np.array(camera.matrix_world.normalized().inverted_safe(), np.float64), np.array(projection, np.float64),
            camera.data.type if camera.type == "CAMERA" else "PERSP", width, height,
            max(getattr(camera.data, "clip_start", 0.1), 1e-6),
        )  # fmt: skip

    @property
    def pixel(self) -> float:
        """Size of a pixel, one length ahead of the camera."""
        if self.kind == "PANO":
            return 2.0 * math.pi / self.width
        return 2.0 / (max(abs(float(self.projection[0, 0])), 1e-12) * self.width)


def dicing_setting(context: ExportContext, name: str, usual: Any) -> Any:
    """What Cycles' settings of the scene have by a name; `usual` where Cycles is off."""
    # Not all that sets settings has Blender copy them for the evaluated scene of a window.
    scene = context.scene if context.window is None else context.depsgraph.scene
    return cycles_property(scene, name, usual)


def rate_of(context: ExportContext, modifier: Any) -> float:
    """Length of an edge: in pixels, or in the object's space."""
    name, usual = ("dicing_rate", 1.0) if context.window is None else ("preview_dicing_rate", 8.0)
    rate = float(dicing_setting(context, name, usual))
    if modifier.adaptive_space == "OBJECT":
        return rate * modifier.adaptive_object_edge_length
    return max(_LEAST_PIXELS, rate * modifier.adaptive_pixel_size)


def most_levels(context: ExportContext) -> int:
    """How many times faces may be divided at most."""
    return int(dicing_setting(context, "max_subdivisions", 12))


def offscreen_scale(context: ExportContext) -> float:
    """By how much edges may be longer for each length that they are out of view."""
    return max(float(dicing_setting(context, "offscreen_dicing_scale", 4.0)), 1.0)


def dicing_of(
    context: ExportContext, item: bpy.types.Object, modifier: Any, view: DicingView, level: int
) -> Dicing:
    """By what an object's mesh is diced.

    Parameters
    ----------
    item : Object
        Evaluated.
    level : int
        How many times an edge may be halved.
    """
    rate = rate_of(context, modifier)
    if modifier.adaptive_space == "OBJECT":
        return Dicing(level, np.eye(3, 4), rate, 0.0, np.zeros((0, 4)), 0.0)
    to_space: npt.NDArray[np.float64] = (view.to_camera @ np.array(item.matrix_world, np.float64))[:3]
    pixel = rate * view.pixel
    if view.kind == "PANO":
        return Dicing(level, to_space, 0.0, pixel, np.zeros((0, 4)), 0.0)
    projection = view.projection
    # A side is where x or y of the projection is 1 or -1 times its weight.
    sides = np.stack([sign * projection[row] - projection[3] for row in (0, 1) for sign in (1.0, -1.0)])
    sides /= np.linalg.norm(sides[:, :3], axis=1, keepdims=True)
    outside = offscreen_scale(context) - 1.0
    if view.kind == "ORTHO":
        return Dicing(level, to_space, pixel, 0.0, sides, outside * pixel * abs(projection[0, 0]))
    return Dicing(level, to_space, 0.0, pixel, sides, outside * pixel)
