# SPDX-License-Identifier: GPL-3.0-or-later
"""What of an error changes from frame to frame, and a camera that turns where it stands."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.flicker import flicker, turned
from benchmarks.metrics import EPSILON
from tests.helpers.small_scenes import corner_scene


def test_an_error_that_stays_does_not_flicker() -> None:
    rng = np.random.default_rng(0)
    references = [np.full((20, 30, 3), 1.0) for _ in range(200)]
    found = flicker([reference + 0.5 for reference in references], references)
    assert found.total == pytest.approx(0.25 / (1.0 + EPSILON)) and found.changing == 0.0
    found = flicker([reference + 0.5 + 0.1 * rng.normal(size=(20, 30, 3)) for reference in references], references)
    assert found.total == pytest.approx(0.26 / (1.0 + EPSILON), rel=0.02)
    assert found.changing == pytest.approx(0.01 / (1.0 + EPSILON), rel=0.02)


def test_the_camera_turns_where_it_stands() -> None:
    still = corner_scene()
    moved = turned(still, np.pi / 2)
    before, after = still.camera.transform, moved.camera.transform
    np.testing.assert_array_equal(after[:3, 3], before[:3, 3])
    np.testing.assert_allclose(after[2, :3], before[2, :3], atol=1e-6)
    np.testing.assert_allclose(after[0, :3], -before[1, :3], atol=1e-6)
    np.testing.assert_allclose(turned(moved, -np.pi / 2).camera.transform, before, atol=1e-6)
