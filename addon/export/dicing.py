# SPDX-License-Identifier: GPL-3.0-or-later
"""How finely Cycles would dice a mesh: by the size of a pixel at its vertices, or by a length in its own space."""

from __future__ import annotations

import math
from typing import Any

import bpy
import numpy as np

from engine.scene.description import Frame
from engine.scene.dicing import Dicing

from .context import ExportContext, cycles_property

#: Cycles takes no lower rate than this many pixels.
_LEAST_PIXELS = 0.1


def rate_of(scene: bpy.types.Scene, modifier: Any) -> float:
    """Length of an edge: in pixels, or in the object's space."""
    rate = float(cycles_property(scene, "dicing_rate", 1.0))
    if modifier.adaptive_space == "OBJECT":
        return rate * modifier.adaptive_object_edge_length
    return max(_LEAST_PIXELS, rate * modifier.adaptive_pixel_size)


def dicing_of(
    context: ExportContext, item: bpy.types.Object, modifier: Any, camera: bpy.types.Object, frame: Frame, level: int
) -> Dicing:
    """By what an object's mesh is diced.

    Parameters
    ----------
    item, camera : Object
        Evaluated.
    level : int
        How many times an edge may be halved.
    """
    rate = rate_of(context.scene, modifier)
    if modifier.adaptive_space == "OBJECT":
        return Dicing(level, np.eye(3, 4), rate, 0.0, np.zeros((0, 4)), 0.0)
    to_camera = np.array(camera.matrix_world.normalized().inverted_safe(), np.float64)
    to_space = (to_camera @ np.array(item.matrix_world, np.float64))[:3]
    kind = camera.data.type if camera.type == "CAMERA" else "PERSP"
    if kind == "PANO":
        return Dicing(level, to_space, 0.0, rate * 2.0 * math.pi / frame.width, np.zeros((0, 4)), 0.0)
    render = context.scene.render
    projection = np.array(camera.calc_matrix_camera(
        context.depsgraph, x=frame.width, y=frame.height, scale_x=render.pixel_aspect_x, scale_y=render.pixel_aspect_y
    ), np.float64)  # fmt: skip
    # A side is where x or y of the projection is 1 or -1 times its weight.
    sides = np.array([sign * projection[row] - projection[3] for row in (0, 1) for sign in (1.0, -1.0)])
    sides /= np.linalg.norm(sides[:, :3], axis=1, keepdims=True)
    pixel = rate * 2.0 / (max(abs(projection[0, 0]), 1e-12) * frame.width)
    outside = max(float(cycles_property(context.scene, "offscreen_dicing_scale", 4.0)), 1.0) - 1.0
    if kind == "ORTHO":
        return Dicing(level, to_space, pixel, 0.0, sides, outside * pixel * abs(projection[0, 0]))
    return Dicing(level, to_space, 0.0, pixel, sides, outside * pixel)
