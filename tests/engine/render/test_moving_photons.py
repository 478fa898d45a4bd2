# SPDX-License-Identifier: GPL-3.0-or-later
"""Caustics of what moves while the shutter is open: the same light as paths find, and less noise."""

from __future__ import annotations

import numpy as np
import pytest

from engine.kernels.photon_windows import part_of_time, window_weight
from engine.render.photon_windows import Windows, share_of_photons
from engine.state.photons import PHOTON_WIDTH, photon_width
from tests.helpers.caustic_scenes import water_scene
from tests.helpers.moving_caustics import moving_pane_scene, rising_floor_scene
from tests.helpers.photon_renders import assert_same_light, pictures

pytestmark = pytest.mark.estimator


@pytest.mark.parametrize("half", [0.5, 0.3, 0.07])
def test_a_window_loses_no_light_at_the_ends_of_the_shutter(half: float) -> None:
    """Nor does it find some twice: each photon, and each path, has the whole window."""
    times = (np.arange(400, dtype=np.float32) + np.float32(0.5)) / np.float32(400)
    weights = np.array([[window_weight(x, y, np.float32(half)) for y in times] for x in times])
    np.testing.assert_allclose(weights.mean(axis=0), 2.0 * half, atol=0.01)
    np.testing.assert_array_equal(weights, weights.T)


def test_a_window_lies_within_two_parts_of_the_shutter() -> None:
    half, times = np.float32(0.07), np.linspace(0.0, 1.0, 301, dtype=np.float32)
    for x in times[::10]:
        ends = max(x - half, np.float32(0.0)), min(x + half, np.float32(1.0))
        first, last = (part_of_time(end, half) for end in ends)
        assert last - first <= 1
        parts = [part_of_time(y, half) for y in times if window_weight(x, y, half) > 0.0]
        assert first <= min(parts) and max(parts) <= last


@pytest.mark.parametrize(("windows", "dimensions"), [
    (Windows(), 2), (Windows(10.0), 3), (Windows(0.0, True), 3), (Windows(10.0, True), 4)
])  # fmt: skip
def test_bias_and_noise_vanish_alike(windows: Windows, dimensions: int) -> None:
    """After n times as many photons the square of the bias, and one over the photons within, are n^(-4 / (d + 4))."""
    radius = windows.first_radius(0.1)
    shrunk = 1000.0**windows.exponent
    before, after = (
        share_of_photons(windows.half_time(radius, s), windows.half_waves(s)) * (radius * s) ** 2 for s in (1.0, shrunk)
    )
    assert after / before == pytest.approx(shrunk**dimensions)
    assert shrunk**4 == pytest.approx(before / (1000.0 * after))
    assert shrunk**4 == pytest.approx(1000.0 ** (-4 / (dimensions + 4)))
    # As many photons as without windows.
    assert before == pytest.approx(0.1**2)


def test_what_hardly_moves_has_photons_of_all_times() -> None:
    windows = Windows(0.001)
    assert windows.first_radius(0.1) == 0.1
    assert windows.half_time(0.1, 1.0) == 0.5
    assert Windows().half_time(0.1, 1.0) == 0.0
    assert photon_width(moves=False, is_spectral=False) == PHOTON_WIDTH


@pytest.mark.parametrize("scene", [moving_pane_scene, rising_floor_scene])
def test_moving_caustics_are_as_bright_as_by_paths(scene) -> None:
    """The casters, or what gathers, fly, turn and grow; columns show the streak."""
    assert_same_light(*(pictures(scene(), caustics) for caustics in ("PHOTONS", "PATHS")), 0.02)


def test_photons_make_less_noise_where_the_lamp_is_small() -> None:
    by_photons, by_paths = (
        pictures(moving_pane_scene(0.3), caustics, range(2), samples=32) for caustics in ("PHOTONS", "PATHS")
    )
    assert 8.0 * by_photons.var(axis=0).mean() < by_paths.var(axis=0).mean()


def test_the_picture_is_the_same_for_any_number_of_threads() -> None:
    one, three = (
        pictures(moving_pane_scene(), "PHOTONS", [1], samples=8, threads=threads) for threads in (1, 3)
    )
    np.testing.assert_array_equal(one, three)


def test_a_moving_camera_changes_no_photons() -> None:
    scene = water_scene()
    still = pictures(scene, "PHOTONS", [1], samples=4)
    scene.camera.motion = np.stack([scene.camera.transform] * 2)
    np.testing.assert_allclose(pictures(scene, "PHOTONS", [1], samples=4), still, rtol=1e-5)
