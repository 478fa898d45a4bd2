# SPDX-License-Identifier: GPL-3.0-or-later
"""The camera as kernels read it, and the pixel filter."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

# Columns of CameraArrays.real
CAMERA_MATRIX = 0  # 12: camera to world
CAMERA_SCALE_X = 12  # film coordinate = pixel * scale + offset, at distance 1 (perspective) or in metres (orthographic)
CAMERA_SCALE_Y = 13
CAMERA_OFFSET_X = 14
CAMERA_OFFSET_Y = 15
CAMERA_CLIP_START = 16
CAMERA_CLIP_END = 17
CAMERA_LENS_RADIUS = 18  # [m], 0 = pinhole
CAMERA_FOCUS = 19  # [m]
CAMERA_BLADES = 20
CAMERA_BLADE_ROTATION = 21
CAMERA_INVERSE_RATIO = 22
CAMERA_KIND = 23
CAMERA_IS_ZOOMING = 24
CAMERA_ZOOM_OPENING = 25  # film coordinates at the shutter's opening over those in its middle
CAMERA_ZOOM_CLOSING = 26
CAMERA_ROLLING = 27  # share of a path's time that its row decides, 0 = none
CAMERA_ROW_COUNT = 28  # of the full image
CAMERA_CLEAR = 29  # [m] around it no medium begins or ends; 0 = not known
CAMERA_PANORAMA = 30  # what kind of panorama: PANORAMA_*
CAMERA_PANORAMA_FIRST = 31  # 9: its parameters, columns from here on
CAMERA_EYE_OFFSET = 40  # [m] to the right, of spherical stereo
CAMERA_CONVERGENCE = 41  # [m], infinity = parallel
CAMERA_MERGE_FROM = 42  # [rad] above the horizon, where the offset begins to go to 0
CAMERA_MERGE_TO = 43
CAMERA_WIDTH = 44

KIND_PERSPECTIVE = 0
KIND_ORTHOGRAPHIC = 1
KIND_PANORAMA = 2

PANORAMA_EQUIRECTANGULAR = 0
PANORAMA_CUBEMAP_FACE = 1
PANORAMA_MIRROR_BALL = 2
PANORAMA_EQUIDISTANT = 3
PANORAMA_EQUISOLID = 4
PANORAMA_LENS_POLYNOMIAL = 5
PANORAMA_CYLINDRICAL = 6

# A panorama's parameters, from CAMERA_PANORAMA_FIRST on. Each kind has its own.
PANORAMA_FOV = 0  # [rad], of fisheyes
PANORAMA_WIDTH = 1  # [mm], of the sensor of fisheyes with a lens
PANORAMA_HEIGHT = 2
PANORAMA_LENS = 3  # [mm], of equisolid fisheyes
PANORAMA_POLYNOMIAL = 4  # 5: k0 to k4
PANORAMA_LEFT = 0  # [rad], of equirectangular ones: what film coordinates the whole film has
PANORAMA_RIGHT = 1
PANORAMA_BOTTOM = 2
PANORAMA_TOP = 3
PANORAMA_CYLINDER_LEFT = 0  # [rad]
PANORAMA_CYLINDER_RIGHT = 1
PANORAMA_CYLINDER_BOTTOM = 2  # of a cylinder of radius 1
PANORAMA_CYLINDER_TOP = 3

FILTER_TABLE_SIZE = 4096
SHUTTER_TABLE_SIZE = 256


class CameraArrays(NamedTuple):
    """The camera's numbers, its places, and what random numbers become.

    real : float32 (CAMERA_WIDTH,)
    filter : float32 (FILTER_TABLE_SIZE,), pixel offset by uniform number
    motion : float32 (K, 12), camera to world at evenly spaced times of the shutter; one row where it stands still
    shutter : float32 (SHUTTER_TABLE_SIZE,), time by uniform number
    """

    real: np.ndarray
    filter: np.ndarray
    motion: np.ndarray
    shutter: np.ndarray
