# SPDX-License-Identifier: GPL-3.0-or-later
"""What a window sees, from Blender's own matrices: overlays then lie where they belong. Holds no bpy."""

from __future__ import annotations

import math

import numpy as np

from engine.array_types import Float32Array
from engine.viewport.view import Plane, Region


def plane_of(projection: Float32Array, *, is_perspective: bool) -> Plane:
    """What a projection matrix shows, at distance 1 (perspective) or in metres (orthographic).

    Parameters
    ----------
    projection : float32 (4, 4)
        View space to clip space, as OpenGL has it, acting on columns.

    Raises
    ------
    ValueError
        If it shows nothing.
    """
    matrix = np.asarray(projection, np.float64)
    if not (np.isfinite(matrix).all() and matrix[0, 0] > 0.0 and matrix[1, 1] > 0.0):
        raise ValueError("the view has no projection: reset it (Home)")
    if is_perspective:
        # x of clip space is (m00 x + m02 z) / -z, so that z = -1 gives m00 x - m02.
        centre_x, centre_y = matrix[0, 2], matrix[1, 2]
    else:
        centre_x, centre_y = -matrix[0, 3], -matrix[1, 3]
    return Plane(
        float((-1.0 + centre_x) / matrix[0, 0]), float((1.0 + centre_x) / matrix[0, 0]),
        float((-1.0 + centre_y) / matrix[1, 1]), float((1.0 + centre_y) / matrix[1, 1]),
    )  # fmt: skip


def border_region(width: int, height: int, border: tuple[float, float, float, float]) -> Region:
    """Pixels of a window that a border (x0, y0, x1, y1) covers, in fractions of the window; never none.

    As Cycles: rounded, and cut off at the window's edges.
    """
    left, bottom, right, top = (min(max(value, 0.0), 1.0) for value in border)
    x0 = min(math.floor(left * width + 0.5), width - 1)
    y0 = min(math.floor(bottom * height + 0.5), height - 1)
    x1 = min(max(math.floor(right * width + 0.5), x0 + 1), width)
    y1 = min(max(math.floor(top * height + 0.5), y0 + 1), height)
    return x0, y0, x1, y1


def frame_in_window(corners: Float32Array, plane: Plane, *, is_perspective: bool) -> tuple[float, float, float, float]:
    """Where a camera's frame lies in the window that looks through it: (x0, y0, x1, y1) in fractions of the window.

    Parameters
    ----------
    corners : float32 (4, 3)
        Corners of the frame in the camera's space (`Camera.view_frame`).
    """
    points = np.asarray(corners, np.float64)
    flat = points[:, :2] / -points[:, 2:] if is_perspective else points[:, :2]
    low, high = flat.min(axis=0), flat.max(axis=0)
    across, up = plane.right - plane.left, plane.top - plane.bottom
    return (
        float((low[0] - plane.left) / across), float((low[1] - plane.bottom) / up),
        float((high[0] - plane.left) / across), float((high[1] - plane.bottom) / up),
    )  # fmt: skip


def within(
    frame: tuple[float, float, float, float], border: tuple[float, float, float, float]
) -> tuple[float, float, float, float]:
    """A border given in fractions of a frame, in fractions of what the frame is given in."""
    across, up = frame[2] - frame[0], frame[3] - frame[1]
    return (
        frame[0] + border[0] * across, frame[1] + border[1] * up, frame[0] + border[2] * across,
        frame[1] + border[3] * up,
    )  # fmt: skip


def panorama_plane(frame: tuple[float, float, float, float], shown: tuple[float, float, float, float]) -> Plane:
    """Film coordinates at a window's edges, where the camera's frame shows `shown` (left, right, bottom, top)."""
    across = (shown[1] - shown[0]) / (frame[2] - frame[0])
    up = (shown[3] - shown[2]) / (frame[3] - frame[1])
    left, bottom = shown[0] - frame[0] * across, shown[2] - frame[1] * up
    return Plane(left, left + across, bottom, bottom + up)
