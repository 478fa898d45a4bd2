# SPDX-License-Identifier: GPL-3.0-or-later
"""Blender's camera as the arrays that `kernels.camera` reads, and the pixel filter's inverse CDF."""

from __future__ import annotations

import numpy as np

from engine.array_types import Float32Array
from engine.builder.motion import interpolation_keys
from engine.builder.panorama import fill_eye, fill_panorama
from engine.scene.description import Camera, Frame
from engine.state.camera import (
    CAMERA_BLADE_ROTATION,
    CAMERA_BLADES,
    CAMERA_CLIP_END,
    CAMERA_CLIP_START,
    CAMERA_CONVERGENCE,
    CAMERA_FOCUS,
    CAMERA_INVERSE_RATIO,
    CAMERA_IS_ZOOMING,
    CAMERA_KIND,
    CAMERA_LENS_RADIUS,
    CAMERA_MERGE_FROM,
    CAMERA_MERGE_TO,
    CAMERA_OFFSET_X,
    CAMERA_OFFSET_Y,
    CAMERA_ROLLING,
    CAMERA_ROW_COUNT,
    CAMERA_SCALE_X,
    CAMERA_SCALE_Y,
    CAMERA_WIDTH,
    CAMERA_ZOOM_CLOSING,
    CAMERA_ZOOM_OPENING,
    FILTER_TABLE_SIZE,
    KIND_ORTHOGRAPHIC,
    KIND_PANORAMA,
    KIND_PERSPECTIVE,
    SHUTTER_TABLE_SIZE,
    CameraArrays,
)

#: Both eyes look in parallel, and merge nowhere.
_MAY_BE_INFINITE = (CAMERA_CONVERGENCE, CAMERA_MERGE_FROM, CAMERA_MERGE_TO)

_KINDS = {"PERSP": KIND_PERSPECTIVE, "ORTHO": KIND_ORTHOGRAPHIC, "PANO": KIND_PANORAMA}


def build_camera(
    camera: Camera,
    frame: Frame,
    pixel_filter: str,
    filter_width: float,
    shutter_curve: Float32Array | None = None,
    rolling_shutter_duration: float = 1.0,
) -> CameraArrays:
    """Rays as Cycles' camera makes them.

    Parameters
    ----------
    shutter_curve : float32 (N,), optional
    rolling_shutter_duration : float, optional
        See `SceneDescription`.

    Raises
    ------
    ValueError
        For an unknown camera kind, a camera without a usable transform or lens, or an image without pixels.
    """
    _check(camera, frame)
    kind = _KINDS[camera.kind]
    row = np.zeros(CAMERA_WIDTH, np.float64)
    row[:12] = _without_scale(camera.transform)[:3].reshape(-1)
    motion = row[None, :12].astype(np.float32)
    if camera.motion is not None:
        motion = interpolation_keys(np.stack([_without_scale(step) for step in camera.motion]).astype(np.float32))

    x_ratio = frame.width * frame.pixel_aspect_x
    y_ratio = frame.height * frame.pixel_aspect_y
    horizontal = x_ratio > y_ratio if camera.sensor_fit == "AUTO" else camera.sensor_fit == "HORIZONTAL"
    by_width = camera.sensor_fit != "VERTICAL"
    aspect = x_ratio / y_ratio if horizontal else y_ratio / x_ratio
    half_x, half_y = (aspect, 1.0) if horizontal else (1.0, aspect)
    if kind == KIND_PANORAMA:
        fill_panorama(row, camera, frame)
    else:
        if kind == KIND_ORTHOGRAPHIC:
            scale = camera.ortho_scale / (2.0 * aspect)
        else:
            scale = 0.5 * (camera.sensor_width if by_width else camera.sensor_height) / camera.lens / aspect
        shift_x = 2.0 * aspect * camera.shift_x
        shift_y = 2.0 * aspect * camera.shift_y
        row[CAMERA_SCALE_X] = 2.0 * half_x * scale / frame.width
        row[CAMERA_OFFSET_X] = (shift_x - half_x) * scale
        row[CAMERA_SCALE_Y] = 2.0 * half_y * scale / frame.height
        row[CAMERA_OFFSET_Y] = (shift_y - half_y) * scale
    row[CAMERA_CLIP_START] = camera.clip_start
    row[CAMERA_CLIP_END] = camera.clip_end
    if camera.use_dof:
        lens = camera.lens * 1e-3 if kind != KIND_ORTHOGRAPHIC else 1.0
        row[CAMERA_LENS_RADIUS] = lens / (2.0 * max(camera.aperture_fstop, 1e-5))
        row[CAMERA_FOCUS] = max(camera.focus_distance, 1e-5)
    fill_eye(row, camera.eye)
    row[CAMERA_BLADES] = camera.aperture_blades if camera.aperture_blades >= 3 else 0
    row[CAMERA_BLADE_ROTATION] = camera.aperture_rotation
    row[CAMERA_INVERSE_RATIO] = 1.0 / max(camera.aperture_ratio, 1e-5)
    row[CAMERA_KIND] = kind
    row[CAMERA_ZOOM_OPENING : CAMERA_ZOOM_CLOSING + 1] = 1.0
    if camera.lens_motion is not None and kind == KIND_PERSPECTIVE:
        lens, width, height = np.asarray(camera.lens_motion, np.float64).T
        with np.errstate(divide="ignore", invalid="ignore"):
            zoom = (width if by_width else height) / lens / (2.0 * aspect * scale)
        if not (np.isfinite(zoom).all() and (zoom > 0.0).all()):
            raise ValueError("the camera zooms to nothing or infinity: check the keyframes and drivers of its lens")
        row[CAMERA_IS_ZOOMING] = (zoom.astype(np.float32) != 1.0).any()
        row[CAMERA_ZOOM_OPENING : CAMERA_ZOOM_CLOSING + 1] = zoom
    if rolling_shutter_duration < 1.0:
        row[CAMERA_ROLLING] = 1.0 - max(rolling_shutter_duration, 0.0)
    row[CAMERA_ROW_COUNT] = frame.height
    if not np.isfinite(np.delete(row, _MAY_BE_INFINITE)).all():
        raise ValueError("the camera has a setting that is NaN or infinity: check its keyframes and drivers")
    table = filter_table(pixel_filter, filter_width)
    return CameraArrays(row.astype(np.float32), table, motion, shutter_table(shutter_curve))


def _check(camera: Camera, frame: Frame) -> None:
    if camera.kind not in _KINDS:
        raise ValueError(f"camera type {camera.kind!r}: choose one of {', '.join(_KINDS)}")
    if frame.width < 1 or frame.height < 1:
        raise ValueError(f"the image is {frame.width} x {frame.height}: set a resolution of at least 1 x 1")
    if not np.isfinite(camera.transform).all():
        raise ValueError("the camera's transform is NaN or infinite: check its constraints and drivers")
    if camera.motion is not None and not np.isfinite(camera.motion).all():
        raise ValueError("the camera moves to NaN or infinity: check its keyframes and drivers")


def _without_scale(transform: Float32Array) -> np.ndarray:
    """Float64 (4, 4): scale of the camera object does not change the picture."""
    matrix = np.array(transform, np.float64)
    lengths = np.linalg.norm(matrix[:3, :3], axis=0)
    if (lengths == 0.0).any():
        raise ValueError("the camera is scaled to zero: reset its scale")
    matrix[:3, :3] /= lengths
    return matrix


def shutter_table(curve: Float32Array | None) -> np.ndarray:
    """Times in [0, 1] for SHUTTER_TABLE_SIZE uniform numbers from 0 to 1, as often as the shutter is open then.

    Parameters
    ----------
    curve : float32 (N,) or None
        How far it is open at evenly spaced times; None, or nowhere above 0: all the time.
    """
    even = np.linspace(0.0, 1.0, SHUTTER_TABLE_SIZE)
    if curve is None:
        return even.astype(np.float32)
    opening = np.maximum(np.nan_to_num(np.asarray(curve, np.float64)), 0.0)
    # Finely, since within a step of the curve the table's own steps are straight.
    fine = np.linspace(0.0, 1.0, 16 * SHUTTER_TABLE_SIZE)
    opening = np.interp(fine, np.linspace(0.0, 1.0, len(opening)), opening)
    cdf = np.concatenate([[0.0], np.cumsum(0.5 * (opening[1:] + opening[:-1]))])
    if not cdf[-1] > 0.0:
        return even.astype(np.float32)
    return np.interp(even, cdf / cdf[-1], fine).astype(np.float32)


def filter_table(pixel_filter: str, width: float) -> np.ndarray:
    """Offset from the pixel's centre [pixels] for FILTER_TABLE_SIZE uniform numbers from 0 to 1.

    `width` is Cycles' filter width: a third of the Gaussian's support, half of Blackman and Harris's. The box is one
    pixel whatever it says, as in Cycles.
    """
    if pixel_filter == "BOX":
        return np.linspace(-0.5, 0.5, FILTER_TABLE_SIZE).astype(np.float32)
    support = width * (3.0 if pixel_filter == "GAUSSIAN" else 2.0)
    x = np.linspace(-0.5 * support, 0.5 * support, 8193)
    if pixel_filter == "GAUSSIAN":
        weight = np.exp(-2.0 * (6.0 * x / support) ** 2)
    else:
        phase = 2.0 * np.pi * (x / support + 0.5)
        weight = 0.35875 - 0.48829 * np.cos(phase) + 0.14128 * np.cos(2 * phase) - 0.01168 * np.cos(3 * phase)
    cdf = np.concatenate([[0.0], np.cumsum(0.5 * (weight[1:] + weight[:-1]))])
    return np.interp(np.linspace(0.0, 1.0, FILTER_TABLE_SIZE), cdf / cdf[-1], x).astype(np.float32)
