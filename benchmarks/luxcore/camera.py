# SPDX-License-Identifier: GPL-3.0-or-later
"""The camera and its film: a lens with any fit of the sensor, and shifts."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from benchmarks.luxcore.properties import Properties


def _fitted(scene: Any) -> tuple[float, float]:
    """Side of the sensor [mm], and pixels of the picture that lie along it."""
    data, width, height = scene.camera.data, scene.render.resolution_x, scene.render.resolution_y
    if data.sensor_fit == "AUTO":
        return data.sensor_width, max(width, height)
    return (data.sensor_height, height) if data.sensor_fit == "VERTICAL" else (data.sensor_width, width)


def pixel_width(scene: Any) -> float:
    """Width of a pixel at a distance of 1."""
    sensor, pixels = _fitted(scene)
    return float(sensor / scene.camera.data.lens / pixels)


def export_camera(scene: Any) -> Properties:
    """Properties of the camera and the film.

    Raises
    ------
    ValueError
        If the camera has more than a lens.
    """
    camera, render = scene.camera, scene.render
    data = camera.data
    if data.type != "PERSP" or data.dof.use_dof or render.use_border or render.pixel_aspect_x != render.pixel_aspect_y:
        raise ValueError("the camera has more than a lens: LuxCore would not show it alike")
    matrix = np.array(camera.matrix_world)
    origin, forward, up = matrix[:3, 3], -matrix[:3, 2], matrix[:3, 1]
    sensor, pixels = _fitted(scene)
    across, along = render.resolution_x / pixels, render.resolution_y / pixels
    # A shift is a share of the fitted side, which spans two units of the screen.
    right, higher = 2.0 * data.shift_x, 2.0 * data.shift_y
    # LuxCore's rows begin one too high: it takes the row y from the bottom for height - 1 - y from the top, as whole
    # numbers would be, and so its pictures lie a pixel too low.
    higher -= 2.0 * along / render.resolution_y
    return {
        "scene.camera.type": "perspective",
        "scene.camera.lookat.orig": [float(v) for v in origin],
        "scene.camera.lookat.target": [float(v) for v in origin + forward],
        "scene.camera.up": [float(v) for v in up],
        "scene.camera.screenwindow": [right - across, right + across, higher - along, higher + along],
        "scene.camera.fieldofview": math.degrees(2.0 * math.atan(0.5 * sensor / data.lens)),
        # It would take an open surface of water for a body that the camera may be in.
        "scene.camera.autovolume.enable": False,
        "film.width": render.resolution_x,
        "film.height": render.resolution_y,
        # Half of what the filter spans, as Blender's width.
        "film.filter.type": "BLACKMANHARRIS",
        "film.filter.width": float(scene.cycles.filter_width),
    }
