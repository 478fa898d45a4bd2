# SPDX-License-Identifier: GPL-3.0-or-later
"""What a window sees, from its matrices."""

from __future__ import annotations

import numpy as np
import pytest

from addon.viewport.window import border_region, frame_in_window, panorama_plane, plane_of, within
from engine.viewport.view import Plane


def perspective(plane: Plane, near: float = 0.1, far: float = 100.0) -> np.ndarray:
    """OpenGL's frustum of a plane at distance 1."""
    left, right, bottom, top = plane
    matrix = np.zeros((4, 4))
    matrix[0, 0], matrix[0, 2] = 2.0 / (right - left), (right + left) / (right - left)
    matrix[1, 1], matrix[1, 2] = 2.0 / (top - bottom), (top + bottom) / (top - bottom)
    matrix[2, 2], matrix[2, 3] = -(far + near) / (far - near), -2.0 * far * near / (far - near)
    matrix[3, 2] = -1.0
    return matrix.astype(np.float32)


def orthographic(plane: Plane) -> np.ndarray:
    left, right, bottom, top = plane
    matrix = np.eye(4)
    matrix[0, 0], matrix[0, 3] = 2.0 / (right - left), -(right + left) / (right - left)
    matrix[1, 1], matrix[1, 3] = 2.0 / (top - bottom), -(top + bottom) / (top - bottom)
    return matrix.astype(np.float32)


@pytest.mark.parametrize("plane", [Plane(-0.5, 0.5, -0.25, 0.25), Plane(-0.1, 0.9, -0.3, 0.2), Plane(2, 3, -5, -4)])
def test_planes_come_back(plane: Plane) -> None:
    assert plane_of(perspective(plane), is_perspective=True) == pytest.approx(plane, abs=1e-5)
    assert plane_of(orthographic(plane), is_perspective=False) == pytest.approx(plane, abs=1e-5)


@pytest.mark.parametrize("matrix", [np.zeros((4, 4)), np.full((4, 4), np.nan)])
def test_a_window_that_shows_nothing_is_named(matrix: np.ndarray) -> None:
    with pytest.raises(ValueError, match="projection"):
        plane_of(matrix, is_perspective=True)


@pytest.mark.parametrize(
    "border, region",
    [
        ((0.0, 0.0, 1.0, 1.0), (0, 0, 100, 50)),
        ((0.25, 0.5, 0.75, 1.0), (25, 25, 75, 50)),
        ((-3.0, -3.0, 0.1, 5.0), (0, 0, 10, 50)),
        ((0.5, 0.5, 0.5, 0.5), (50, 25, 51, 26)),
        ((2.0, 2.0, 3.0, 3.0), (99, 49, 100, 50)),
    ],
)
def test_borders(border: tuple[float, ...], region: tuple[int, ...]) -> None:
    assert border_region(100, 50, border) == region


def test_a_border_in_a_window_of_one_pixel() -> None:
    assert border_region(1, 1, (0.2, 0.2, 0.4, 0.4)) == (0, 0, 1, 1)


def test_the_cameras_frame_lies_in_its_window() -> None:
    """The frame is half as wide as the window and stands to the left, at any distance."""
    corners = 3.0 * np.array([(-0.4, -0.1, -1), (-0.4, 0.2, -1), (0.1, 0.2, -1), (0.1, -0.1, -1)])
    frame = frame_in_window(corners, Plane(-0.5, 0.5, -0.2, 0.4), is_perspective=True)
    assert frame == pytest.approx((0.1, 1 / 6, 0.6, 2 / 3))
    assert within(frame, (0.0, 0.0, 1.0, 1.0)) == pytest.approx(frame)
    assert within(frame, (0.5, 0.0, 1.0, 0.5)) == pytest.approx((0.35, 1 / 6, 0.6, 5 / 12))


def test_a_panorama_fills_its_frame() -> None:
    full = (0.0, 1.0, 0.1, 1.1)
    assert panorama_plane((0.0, 0.0, 1.0, 1.0), full) == pytest.approx(full)
    assert panorama_plane((0.25, 0.0, 0.75, 0.5), full) == pytest.approx((-0.5, 1.5, 0.1, 2.1))
