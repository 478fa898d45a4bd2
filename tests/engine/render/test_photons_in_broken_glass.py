# SPDX-License-Identifier: GPL-3.0-or-later
"""Caustics through glass that is no closed surface: paths say what it means, and photons find the same."""

from __future__ import annotations

import numpy as np
import pytest

from tests.helpers.caustic_scenes import BROKEN_KINDS, broken_glass_scene
from tests.helpers.photon_renders import assert_same_light, pictures

pytestmark = pytest.mark.estimator


@pytest.mark.parametrize("kind", BROKEN_KINDS)
def test_the_light_is_that_of_paths(kind: str) -> None:
    by_photons, by_paths = (pictures(broken_glass_scene(kind), caustics) for caustics in ("PHOTONS", "PATHS"))
    assert np.isfinite(by_photons).all()
    assert_same_light(by_photons, by_paths, 0.02)
