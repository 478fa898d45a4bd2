# SPDX-License-Identifier: GPL-3.0-or-later
"""The camera as shader nodes see it: spaces of Camera and Window coordinates."""

from __future__ import annotations

import numpy as np

from engine.array_types import Float32Array
from engine.builder.camera import build_camera
from engine.scene.description import Camera, Frame
from engine.state.camera import CAMERA_OFFSET_X, CAMERA_OFFSET_Y, CAMERA_SCALE_X, CAMERA_SCALE_Y, CAMERA_WIDTH
from engine.state.shaders import CAMERA_LENS, CAMERA_ROWS, CAMERA_TO_WORLD, CAMERA_WORLD_TO_CAMERA, CAMERA_WORLD_TO_NDC


def camera_matrices(camera: Camera, frame: Frame) -> Float32Array:
    """`ShaderArrays.camera`.

    Camera space looks along +z as in Cycles. Window coordinates run from 0 to 1 over the full image. Those of panoramas
    are no matrix: kernels ask the camera itself.
    """
    rows = np.zeros((CAMERA_ROWS, CAMERA_WIDTH), np.float32)
    to_world = np.array(camera.transform, np.float64) @ np.diag([1.0, 1.0, -1.0, 1.0])
    # The scale of the camera object does not count.
    to_world[:3, :3] /= np.maximum(np.linalg.norm(to_world[:3, :3], axis=0), 1e-20)
    to_camera = np.linalg.inv(to_world)
    window = np.array([[1.0, 0, 0, 0], [0, 1.0, 0, 0], [0, 0, 0, 1.0]])
    real = np.asarray(build_camera(camera, frame, "BOX", 1.0).real, np.float64)
    if camera.kind in ("PERSP", "ORTHO"):
        # film coordinate = pixel * scale + offset, where film = x / z (perspective) or x.
        inverse_x = 1.0 / (real[CAMERA_SCALE_X] * frame.width)
        inverse_y = 1.0 / (real[CAMERA_SCALE_Y] * frame.height)
        depth = 2 if camera.kind == "PERSP" else 3
        window = np.zeros((3, 4))
        window[0, 0] = inverse_x
        window[1, 1] = inverse_y
        window[0, depth] = -real[CAMERA_OFFSET_X] * inverse_x
        window[1, depth] = -real[CAMERA_OFFSET_Y] * inverse_y
        window[2, depth] = 1.0
    rows[CAMERA_WORLD_TO_CAMERA, :12] = to_camera[:3].ravel()
    rows[CAMERA_TO_WORLD, :12] = to_world[:3].ravel()
    rows[CAMERA_WORLD_TO_NDC, :12] = (window @ to_camera).ravel()
    rows[CAMERA_LENS] = real
    return rows
