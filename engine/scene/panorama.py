# SPDX-License-Identifier: GPL-3.0-or-later
"""Cameras that see more than a plane can show, and the two eyes of spherical stereo."""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True)
class Panorama:
    """How a panoramic camera maps the film to directions, by the names of Blender's properties.

    Each kind reads its own fields only.

    Attributes
    ----------
    kind : str
        'EQUIRECTANGULAR', 'EQUIANGULAR_CUBEMAP_FACE', 'MIRRORBALL', 'FISHEYE_EQUIDISTANT', 'FISHEYE_EQUISOLID',
        'FISHEYE_LENS_POLYNOMIAL' or 'CENTRAL_CYLINDRICAL'.
    latitude_min, latitude_max, longitude_min, longitude_max : float  [rad]
    fisheye_fov : float  [rad]
    fisheye_lens : float  [mm]
    polynomial : 5 floats
        The angle [rad] at a distance of r [mm] from the film's centre is -(k0 + k1 r + k2 r^2 + k3 r^3 + k4 r^4).
    cylinder : 4 floats
        Of a cylinder of radius 1: first and last angle [rad], lowest and highest point.
    sensor : 2 floats
        Width and height of the film [mm], of fisheyes with a lens.
    window : 4 floats
        Left, right, bottom and top edge of what is seen. The whole film is 0, 1, 0, 1.
    """

    kind: str = "EQUIRECTANGULAR"
    latitude_min: float = -math.pi / 2
    latitude_max: float = math.pi / 2
    longitude_min: float = -math.pi
    longitude_max: float = math.pi
    fisheye_fov: float = math.pi
    fisheye_lens: float = 10.5
    polynomial: tuple[float, float, float, float, float] = (0.0, 0.0, 0.0, 0.0, 0.0)
    cylinder: tuple[float, float, float, float] = (-math.pi, math.pi, -1.0, 1.0)
    sensor: tuple[float, float] = (36.0, 36.0)
    window: tuple[float, float, float, float] = (0.0, 1.0, 0.0, 1.0)


@dataclass(frozen=True)
class StereoEye:
    """An eye that turns with the direction it looks in, so that a panorama is in stereo all around.

    Attributes
    ----------
    offset : float  [m]
        From the camera to the right; of the left eye below 0.
    convergence : float  [m]
        Distance at which both eyes see the same. Infinity: they look in parallel.
    merge_from, merge_to : float  [rad]
        Between these heights the offset goes to 0. Infinity: nowhere.
    """

    offset: float
    convergence: float = math.inf
    merge_from: float = math.inf
    merge_to: float = math.inf
