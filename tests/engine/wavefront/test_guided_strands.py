# SPDX-License-Identifier: GPL-3.0-or-later
"""What is learned changes no mean of fibres, whose lobes send light all around."""

from __future__ import annotations

import numpy as np
import pytest

from engine.scene.rounds import RIBBONS, ROUND
from tests.helpers.fur_scenes import fur_scene
from tests.helpers.media_renders import means_by_seed


@pytest.mark.slow
@pytest.mark.parametrize("shape", [RIBBONS, ROUND])
@pytest.mark.parametrize(
    "settings", [{"guiding_method": "VMM", "guiding_trial": False}, {"radiance_cache": "CONVERGING"}]
)
def test_what_is_learned_changes_no_mean_of_fur(settings: dict, shape: str) -> None:
    """By four standard errors, which are within 1% of the mean."""
    scene = fur_scene(shape)
    plain, learned = (means_by_seed(scene, samples=128, seeds=12, **given) for given in ({}, settings))
    error = np.hypot(plain.std(axis=0, ddof=1), learned.std(axis=0, ddof=1)) / np.sqrt(12)
    assert (4.0 * error <= 0.01 * plain.mean(axis=0)).all()
    assert (np.abs(plain.mean(axis=0) - learned.mean(axis=0)) <= 4.0 * error).all()
