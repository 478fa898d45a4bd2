# SPDX-License-Identifier: GPL-3.0-or-later
"""How finely Cycles would dice a mesh: by the size of a pixel at its vertices, or by a length in its own space."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import bpy
import numpy as np

from engine.array_types import Float32Array
from engine.scene.description import Frame
from engine.scene.dicing import Dicing

from .context import cycles_property

#: Cycles takes no lower rate than this many pixels.
_LEAST_PIXELS = 0.1


@dataclass(frozen=True)
class DicingView:
    """What meshes are diced for.

    to_camera : float64 (4, 4), which looks along -z
    projection : float64 (4, 4), or None for panoramas
    width : pixels of the picture
    offscreen : by how much more a pixel grows with each length of the distance out of view
    """

    to_camera: np.ndarray
    projection: np.ndarray | None
    is_orthographic: bool
    width: int
    offscreen: float

    def pixel_sizes(self, points: np.ndarray) -> np.ndarray:
        """Length of a pixel at points of the world, (N,), as if they were straight ahead."""
        local = points @ self.to_camera[:3, :3].T + self.to_camera[:3, 3]
        distance = np.linalg.norm(local, axis=1)
        if self.projection is None:
            return distance * (2.0 * math.pi / self.width)
        unit = 2.0 / (abs(self.projection[0, 0]) * self.width)
        beyond = self._beyond(local)
        if self.is_orthographic:
            return unit * (1.0 + (self.offscreen - 1.0) * beyond * abs(self.projection[0, 0]))
        return unit * (distance + (self.offscreen - 1.0) * beyond)

    def _beyond(self, local: np.ndarray) -> np.ndarray:
        """How far points of the camera's space are out of view: the largest distance from its sides, or from itself."""
        assert self.projection is not None
        # A side is where x or y of the projection is 1 or -1 times its weight.
        weight = self.projection[3]
        homogeneous = np.concatenate([local, np.ones((len(local), 1))], axis=1)
        beyond = np.zeros(len(local))
        for row in (0, 1):
            for sign in (1.0, -1.0):
                plane = sign * self.projection[row] - weight
                beyond = np.maximum(beyond, homogeneous @ plane / np.linalg.norm(plane[:3]))
        if self.is_orthographic:
            return beyond
        behind = local[:, 2] > 0.0
        distance = np.linalg.norm(local, axis=1)
        return np.where(behind, distance, np.minimum(beyond, distance))


def dicing_view(
    scene: bpy.types.Scene, depsgraph: bpy.types.Depsgraph, camera: bpy.types.Object, frame: Frame
) -> DicingView:
    """What the scene's meshes are diced for.

    Parameters
    ----------
    camera : Object
        Evaluated.
    """
    to_camera = np.array(camera.matrix_world.normalized().inverted_safe(), np.float64)
    kind = camera.data.type if camera.type == "CAMERA" else "PERSP"
    projection = None
    if kind != "PANO":
        render = scene.render
        projection = np.array(camera.calc_matrix_camera(
            depsgraph, x=frame.width, y=frame.height, scale_x=render.pixel_aspect_x, scale_y=render.pixel_aspect_y
        ), np.float64)  # fmt: skip
    offscreen = max(float(cycles_property(scene, "offscreen_dicing_scale", 4.0)), 1.0)
    return DicingView(to_camera, projection, kind == "ORTHO", frame.width, offscreen)


@dataclass(frozen=True)
class DicedObject:
    """How the mesh of an object is diced.

    view : None: `rate` is a length in the object's space, else one in pixels
    level : how many times an edge may be halved
    """

    view: DicingView | None
    rate: float
    to_world: np.ndarray
    level: int

    def dicing(self, vertices: Float32Array) -> Dicing:
        """By what a mesh of these vertices is divided."""
        if self.view is None:
            lengths = np.full(len(vertices), self.rate, np.float32)
            return Dicing(lengths, np.eye(3, dtype=np.float32), self.level)
        points = np.nan_to_num(vertices.astype(np.float64)) @ self.to_world[:3, :3].T + self.to_world[:3, 3]
        lengths = (self.rate * self.view.pixel_sizes(points)).astype(np.float32)
        return Dicing(lengths, self.to_world[:3, :3].astype(np.float32), self.level)


def rate_of(scene: bpy.types.Scene, modifier: Any) -> float:
    """Length of an edge: in pixels, or in the object's space."""
    rate = float(cycles_property(scene, "dicing_rate", 1.0))
    if modifier.adaptive_space == "OBJECT":
        return rate * modifier.adaptive_object_edge_length
    return max(_LEAST_PIXELS, rate * modifier.adaptive_pixel_size)
