# SPDX-License-Identifier: GPL-3.0-or-later
"""The scene's camera and frame, with the conventions of Blender's own renderers."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from engine.array_types import Float32Array
from engine.scene.description import Camera, Frame

from ..declared_settings import SCENE_SETTINGS
from ..shared_settings import setting_source
from .context import ExportContext
from .panorama import read_eye, read_panorama, uses_spherical_stereo

if TYPE_CHECKING:
    import bpy


def find_camera(context: ExportContext) -> bpy.types.Object:
    """The active camera, original: markers may make another one active at another time.

    Raises
    ------
    ValueError
        If the scene has none.
    """
    override = getattr(context.engine, "camera_override", None)
    camera_object = override or context.scene.camera
    if camera_object is None:
        raise ValueError(
            f"Scene {context.scene.name!r} has no camera: add one, or choose one in Scene properties > Camera"
        )
    return camera_object.original


def export_camera(context: ExportContext, camera_object: bpy.types.Object) -> Camera:
    """A camera as it is now.

    Parameters
    ----------
    camera_object : Object
        Original.

    Raises
    ------
    ValueError
        If it is scaled to nothing.
    """
    camera_object = camera_object.evaluated_get(context.depsgraph)
    transform = _without_scale(_model_matrix(context, camera_object))
    if not np.isfinite(transform).all() or not abs(np.linalg.det(transform[:3, :3])) > 1e-6:
        raise ValueError(f"Camera {camera_object.name!r} is scaled to zero or infinity: clear its scale (Alt S)")
    data = camera_object.data
    if camera_object.type != "CAMERA":
        return _camera_of_other_object(context, camera_object, transform)
    dof = data.dof
    camera = Camera(
        kind=data.type,
        transform=transform,
        lens=data.lens,
        sensor_width=data.sensor_width,
        sensor_height=data.sensor_height,
        sensor_fit=data.sensor_fit,
        ortho_scale=data.ortho_scale,
        shift_x=_shift_x(context, camera_object),
        shift_y=data.shift_y,
        clip_start=data.clip_start,
        clip_end=data.clip_end,
        use_dof=dof.use_dof,
        focus_distance=_focus_distance(camera_object, transform),
        aperture_fstop=max(dof.aperture_fstop, 1e-5),
        aperture_blades=dof.aperture_blades,
        aperture_rotation=dof.aperture_rotation,
        aperture_ratio=dof.aperture_ratio,
        eye=read_eye(context, camera_object),
    )
    if data.type == "PANO":
        camera.panorama = read_panorama(context, data, (camera.shift_x, camera.shift_y))
    elif data.type == "CUSTOM":
        context.notice(camera_object.name, "a camera scripted in OSL is not supported", "perspective camera")
        camera.kind = "PERSP"
    return camera


def in_middle(camera: Camera, middle: Camera) -> Camera:
    """The camera of a frame whose shutter has its middle elsewhere.

    As Cycles: place and field of view are those of the middle, everything else, the lens's radius included, that of the
    frame itself.
    """
    if camera.kind != "PERSP":
        return replace(camera, transform=middle.transform)
    return replace(
        camera,
        transform=middle.transform,
        lens=middle.lens,
        sensor_width=middle.sensor_width,
        sensor_height=middle.sensor_height,
        aperture_fstop=camera.aperture_fstop * middle.lens / camera.lens,
    )


def export_frame(context: ExportContext) -> Frame:
    """Resolution, border and film exposure."""
    render = context.scene.render
    width = max(render.resolution_x * render.resolution_percentage // 100, 1)
    height = max(render.resolution_y * render.resolution_percentage // 100, 1)
    region = (0, 0, width, height)
    if render.use_border:
        # As Cycles and the render pipeline: truncated, and never empty.
        x0 = min(int(np.float32(render.border_min_x) * np.float32(width)), width - 1)
        y0 = min(int(np.float32(render.border_min_y) * np.float32(height)), height - 1)
        x1 = int(np.float32(render.border_max_x) * np.float32(width))
        y1 = int(np.float32(render.border_max_y) * np.float32(height))
        region = (x0, y0, max(x1, x0 + 1), max(y1, y0 + 1))
    return Frame(
        width=width,
        height=height,
        region=region,
        pixel_aspect_x=render.pixel_aspect_x,
        pixel_aspect_y=render.pixel_aspect_y,
        exposure=film_exposure(context.scene),
    )


def film_exposure(scene: bpy.types.Scene) -> float:
    """The setting that counts; 1 where there is none, since neither add-on is registered.

    Raises
    ------
    ValueError
        If it is none that a film can have.
    """
    owner, name = setting_source(scene, "film_exposure")
    if owner is None:
        return 1.0
    exposure = float(getattr(owner, name))
    SCENE_SETTINGS["film_exposure"].check(exposure)
    return exposure


def _model_matrix(context: ExportContext, camera_object: bpy.types.Object) -> Float32Array:
    if context.engine is not None:
        is_spherical = uses_spherical_stereo(context, camera_object)
        matrix = context.engine.camera_model_matrix(camera_object, use_spherical_stereo=is_spherical)
        return np.array(matrix, np.float32).reshape(4, 4)
    return np.array(camera_object.matrix_world, np.float32)


def _shift_x(context: ExportContext, camera_object: bpy.types.Object) -> float:
    if context.engine is not None:
        is_spherical = uses_spherical_stereo(context, camera_object)
        return float(context.engine.camera_shift_x(camera_object, use_spherical_stereo=is_spherical))
    return float(camera_object.data.shift_x)


def _without_scale(matrix: Float32Array) -> Float32Array:
    result = matrix.copy()
    length = np.linalg.norm(result[:3, :3], axis=0)
    result[:3, :3] /= np.where(length > 0.0, length, 1.0)
    return result


def _focus_distance(camera_object: bpy.types.Object, transform: Float32Array) -> float:
    """Distance [m] along the camera's axis to the focus object, or the one typed in."""
    dof = camera_object.data.dof
    target = dof.focus_object
    if target is None:
        return float(dof.focus_distance)
    matrix = target.matrix_world
    bone_name = getattr(dof, "focus_subtarget", "")
    if bone_name and target.pose is not None and bone_name in target.pose.bones:
        matrix = matrix @ target.pose.bones[bone_name].matrix
    offset = transform[:3, 3] - np.array(matrix, np.float32)[:3, 3]
    return float(abs(np.dot(transform[:3, 2], offset)))


def _camera_of_other_object(context: ExportContext, camera_object: bpy.types.Object, transform: Float32Array) -> Camera:
    """Blender lets any object be the camera; a light is looked through with the opening of its spot."""
    lens = 50.0
    if camera_object.type == "LIGHT":
        angle = getattr(camera_object.data, "spot_size", 0.0)
        tangent = math.tan(0.5 * angle)
        if tangent > 0.0:
            lens = 16.0 / tangent
    return Camera(transform=transform, lens=lens, clip_start=1e-5, clip_end=1e5)
