# SPDX-License-Identifier: GPL-3.0-or-later
"""Panoramic cameras and the eyes of spherical stereo, as Cycles reads them."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from engine.scene.panorama import Panorama, StereoEye

from ..versions import read_setting
from .context import ExportContext

if TYPE_CHECKING:
    import bpy

_ANGLES = ("latitude_min", "latitude_max", "longitude_min", "longitude_max", "fisheye_fov", "fisheye_lens")
_SIGNS = {"left": -1.0, "right": 1.0}


def read_panorama(context: ExportContext, data: bpy.types.Camera, shift: tuple[float, float]) -> Panorama:
    """What a panoramic camera's film sees.

    Parameters
    ----------
    data : Camera
        Evaluated.
    shift : 2 floats
        Of the film, in widths and heights of it.
    """
    values = {name: read_setting(data, name) for name in _ANGLES}
    given = {name: float(value) for name, value in values.items() if value is not None}
    kind = read_setting(data, "panorama_type")
    left, bottom = shift
    polynomial = tuple(float(read_setting(data, f"fisheye_polynomial_k{power}")) for power in range(5))
    cylinder = [float(read_setting(data, f"central_cylindrical_range_{name}"))
                for name in ("u_min", "u_max", "v_min", "v_max")]  # fmt: skip
    radius = float(read_setting(data, "central_cylindrical_radius"))
    return Panorama(
        kind=kind,
        polynomial=polynomial,  # type: ignore[arg-type]
        cylinder=(cylinder[0], cylinder[1], cylinder[2] / radius, cylinder[3] / radius),
        sensor=_sensor(context, data),
        window=(left, left + 1.0, bottom, bottom + 1.0),
        **given,
    )


def uses_spherical_stereo(context: ExportContext, camera_object: bpy.types.Object) -> bool:
    """Whether the eyes turn with the direction they look in, so that the camera itself stays in the middle."""
    return context.engine is not None and bool(context.engine.use_spherical_stereo(camera_object))


def read_eye(context: ExportContext, camera_object: bpy.types.Object) -> StereoEye | None:
    """The eye of the view that is exported; None: no spherical stereo, or a view that is no eye."""
    if context.engine is None or not uses_spherical_stereo(context, camera_object):
        return None
    sign = _SIGNS.get(context.engine.active_view_get())
    if sign is None:
        return None
    stereo = camera_object.data.stereo
    is_parallel = stereo.convergence_mode == "PARALLEL"
    return StereoEye(
        offset=0.5 * sign * stereo.interocular_distance,
        convergence=math.inf if is_parallel else stereo.convergence_distance,
        merge_from=stereo.pole_merge_angle_from if stereo.use_pole_merge else math.inf,
        merge_to=stereo.pole_merge_angle_to if stereo.use_pole_merge else math.inf,
    )


def _sensor(context: ExportContext, data: bpy.types.Camera) -> tuple[float, float]:
    """Width and height [mm] of the film, fitted to the picture that is rendered, whatever a window shows of it."""
    render = context.scene.render
    across = render.resolution_x * render.pixel_aspect_x
    up = render.resolution_y * render.pixel_aspect_y
    size = data.sensor_height if data.sensor_fit == "VERTICAL" else data.sensor_width
    if across > up if data.sensor_fit == "AUTO" else data.sensor_fit == "HORIZONTAL":
        return size, size * up / across
    return size * across / up, size
