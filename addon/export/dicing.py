# SPDX-License-Identifier: GPL-3.0-or-later
"""How finely Cycles would dice a mesh: by the size of a pixel at its vertices, or by a length in its own space."""

from __future__ import annotations

from typing import Any

import bpy
import numpy as np
import numpy.typing as npt

from engine.scene.dicing import Dicing

from .context import ExportContext, cycles_property
from .dicing_view import DicingView

#: Cycles takes no lower rate than this many pixels.
_LEAST_PIXELS = 0.1


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
