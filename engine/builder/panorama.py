# SPDX-License-Identifier: GPL-3.0-or-later
"""Panoramas and eyes as the numbers that `kernels.panorama` reads."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from engine.state.camera import (
    CAMERA_CONVERGENCE,
    CAMERA_EYE_OFFSET,
    CAMERA_MERGE_FROM,
    CAMERA_MERGE_TO,
    CAMERA_OFFSET_X,
    CAMERA_OFFSET_Y,
    CAMERA_PANORAMA,
    CAMERA_PANORAMA_FIRST,
    CAMERA_SCALE_X,
    CAMERA_SCALE_Y,
    PANORAMA_BOTTOM,
    PANORAMA_CUBEMAP_FACE,
    PANORAMA_CYLINDER_LEFT,
    PANORAMA_CYLINDER_TOP,
    PANORAMA_CYLINDRICAL,
    PANORAMA_EQUIDISTANT,
    PANORAMA_EQUIRECTANGULAR,
    PANORAMA_EQUISOLID,
    PANORAMA_FOV,
    PANORAMA_HEIGHT,
    PANORAMA_LEFT,
    PANORAMA_LENS,
    PANORAMA_LENS_POLYNOMIAL,
    PANORAMA_MIRROR_BALL,
    PANORAMA_POLYNOMIAL,
    PANORAMA_RIGHT,
    PANORAMA_TOP,
    PANORAMA_WIDTH,
)

if TYPE_CHECKING:
    from engine.scene.description import Camera, Frame
    from engine.scene.panorama import StereoEye

_KINDS = {
    "EQUIRECTANGULAR": PANORAMA_EQUIRECTANGULAR,
    "EQUIANGULAR_CUBEMAP_FACE": PANORAMA_CUBEMAP_FACE,
    "MIRRORBALL": PANORAMA_MIRROR_BALL,
    "FISHEYE_EQUIDISTANT": PANORAMA_EQUIDISTANT,
    "FISHEYE_EQUISOLID": PANORAMA_EQUISOLID,
    "FISHEYE_LENS_POLYNOMIAL": PANORAMA_LENS_POLYNOMIAL,
    "CENTRAL_CYLINDRICAL": PANORAMA_CYLINDRICAL,
}


def fill_panorama(row: npt.NDArray[np.float64], camera: Camera, frame: Frame) -> None:
    """Put a panoramic camera's film and mapping into `CameraArrays.real`.

    Parameters
    ----------
    row : float64 (CAMERA_WIDTH,)

    Raises
    ------
    ValueError
        For an unknown kind of panorama.
    """
    panorama = camera.panorama
    if panorama.kind not in _KINDS:
        raise ValueError(f"panorama type {panorama.kind!r}: choose one of {', '.join(_KINDS)}")
    left, right, bottom, top = panorama.window
    row[CAMERA_SCALE_X], row[CAMERA_OFFSET_X] = (right - left) / frame.width, left
    row[CAMERA_SCALE_Y], row[CAMERA_OFFSET_Y] = (top - bottom) / frame.height, bottom
    kind = row[CAMERA_PANORAMA] = _KINDS[panorama.kind]
    own = row[CAMERA_PANORAMA_FIRST:]
    if kind == PANORAMA_EQUIRECTANGULAR:
        # Its film coordinates are angles.
        across, up = panorama.longitude_max - panorama.longitude_min, panorama.latitude_max - panorama.latitude_min
        row[CAMERA_SCALE_X] *= across
        row[CAMERA_SCALE_Y] *= up
        row[CAMERA_OFFSET_X] = panorama.longitude_min + left * across
        row[CAMERA_OFFSET_Y] = panorama.latitude_min + bottom * up
        own[PANORAMA_LEFT], own[PANORAMA_RIGHT] = panorama.longitude_min, panorama.longitude_max
        own[PANORAMA_BOTTOM], own[PANORAMA_TOP] = panorama.latitude_min, panorama.latitude_max
    elif kind == PANORAMA_CYLINDRICAL:
        own[PANORAMA_CYLINDER_LEFT : PANORAMA_CYLINDER_TOP + 1] = panorama.cylinder
    else:
        own[PANORAMA_FOV] = panorama.fisheye_fov
        own[PANORAMA_WIDTH], own[PANORAMA_HEIGHT] = panorama.sensor
        own[PANORAMA_LENS] = panorama.fisheye_lens
        own[PANORAMA_POLYNOMIAL : PANORAMA_POLYNOMIAL + 5] = panorama.polynomial


def fill_eye(row: npt.NDArray[np.float64], eye: StereoEye | None) -> None:
    """Put an eye of spherical stereo into `CameraArrays.real`; None: the camera is in the middle."""
    if eye is not None:
        row[CAMERA_EYE_OFFSET], row[CAMERA_CONVERGENCE] = eye.offset, eye.convergence
        row[CAMERA_MERGE_FROM], row[CAMERA_MERGE_TO] = eye.merge_from, eye.merge_to
