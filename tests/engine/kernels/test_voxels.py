# SPDX-License-Identifier: GPL-3.0-or-later
"""What grids of voxels hold between their centres: by straight lines, by cubic splines, and where things have moved."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.interpolate import BSpline

from engine.builder.grids import build_grids
from engine.kernels.shader.grids import moved_point, sample_alpha, sample_grid
from engine.runtime.jit import kernel
from engine.scene.grids import VolumeMotion
from tests.helpers.media_scenes import grid_of, media_scene, medium, placed

SIZE = 10


@kernel
def _look_up(grids, points, is_smooth, out):
    for row in range(len(points)):
        p = (points[row, 0], points[row, 1], points[row, 2])
        out[row, 0], out[row, 1], out[row, 2] = sample_grid(grids, 0, p, is_smooth)
        out[row, 3] = sample_alpha(grids, 0, p, is_smooth)


@kernel
def _move(geometry, points, times, out):
    for row in range(len(points)):
        p = (points[row, 0], points[row, 1], points[row, 2])
        out[row, 0], out[row, 1], out[row, 2] = moved_point(geometry, 0, times[row], p)


def _weights(at, is_smooth):
    """Weights of all voxels along an axis, at coordinates float64 (N,): (N, SIZE)."""
    distance = np.abs(at[:, None] - np.arange(SIZE))
    if not is_smooth:
        return np.maximum(1.0 - distance, 0.0)
    return np.nan_to_num(BSpline.basis_element(np.arange(-2.0, 3.0), extrapolate=False)(distance))


def _expected(values, points, is_smooth):
    x, y, z = (_weights(points[:, axis], is_smooth) for axis in range(3))
    return np.einsum("ni,nj,nk,ijkc->nc", x, y, z, values)


@pytest.mark.parametrize("is_smooth", [False, True])
@pytest.mark.parametrize("width", [1, 3, 4])
def test_values_between_voxels_are_those_of_straight_lines_or_cubic_splines(width, is_smooth):
    random = np.random.default_rng(3)
    values = random.random((SIZE, SIZE, SIZE, width))
    scene = media_scene([medium("Scatter")], [placed()])
    scene.meshes[0].grids["density"] = grid_of(values, np.eye(4))
    grids, _numbers = build_grids(scene.meshes, {"density"})
    points = random.uniform(-3.0, SIZE + 2.0, (400, 3))
    found = np.zeros((len(points), 4), np.float32)
    _look_up(grids, points.astype(np.float32), is_smooth, found)
    expected = _expected(values, points, is_smooth)
    assert np.allclose(found[:, :3], expected[:, :3], atol=1e-4)
    assert np.allclose(found[:, 3], expected[:, 3] if width == 4 else 1.0, atol=1e-4)


def test_what_moves_is_looked_up_two_steps_back_along_its_velocity():
    from engine.builder.scene import SceneCache, build_scene
    from engine.settings import RenderSettings

    random = np.random.default_rng(5)
    velocity = random.normal(size=(SIZE, SIZE, SIZE, 3))
    transform = placed((2.0, 0.5, 1.0), (1.0, -1.0, 3.0))
    scene = media_scene([medium("Scatter")], [transform])
    scene.meshes[0].volume_motion = VolumeMotion(grid_of(velocity, np.eye(4)), 0.25, 0.8)
    assert scene.is_moving
    geometry = build_scene(scene, RenderSettings(), SceneCache()).geometry
    points = random.uniform(0.0, SIZE - 1.0, (300, 3))
    world = points @ transform[:3, :3].T + transform[:3, 3]
    times = random.random(len(points))
    found = np.zeros((len(points), 3), np.float32)
    _move(geometry, world.astype(np.float32), times.astype(np.float32), found)
    step = -0.8 * (times - 0.25)[:, None]
    back = points + step * _expected(velocity, points, False)
    expected = points + step * _expected(velocity, back, False)
    assert np.allclose(found, expected @ transform[:3, :3].T + transform[:3, 3], atol=2e-3)
    # And nothing goes further than is said.
    least, most = scene.meshes[0].volume_motion.displacement()
    moved = points - expected
    assert (moved >= least - 1e-3).all() and (moved <= most + 1e-3).all()


def test_a_grid_of_one_speed_moves_by_all_speeds_from_0_to_it():
    grid = grid_of(np.full((8, 8, 8, 3), (1.0, 0.0, -2.0)), np.eye(4))
    least, most = VolumeMotion(grid, 0.5, 3.0).displacement()
    assert np.allclose(least, (-1.5, 0.0, -3.0)) and np.allclose(most, (1.5, 0.0, 3.0))
    least, most = VolumeMotion(grid, 0.0, 3.0).displacement()
    assert np.allclose(least, (0.0, 0.0, -6.0)) and np.allclose(most, (3.0, 0.0, 0.0))
