# SPDX-License-Identifier: GPL-3.0-or-later
"""What is learned changes no mean of fibres, whose lobes send light all around."""

from __future__ import annotations

import numpy as np
import pytest

from engine.scene.digest import light_digest
from engine.scene.rounds import RIBBONS, ROUND
from tests.helpers.fur_scenes import fur_scene
from tests.helpers.media_renders import means_by_seed


@pytest.mark.slow
@pytest.mark.parametrize("shape", [RIBBONS, ROUND])
def test_guiding_changes_no_mean_of_fur(shape: str) -> None:
    """By four standard errors, which are within 1% of the mean; guided wherever it can be.

    No path would end in a radiance cache here: `tests/helpers/pits.py` has such a scene.
    """
    scene = fur_scene(shape)
    settings = {"guiding_method": "VMM", "guiding_trial": False, "learn_guiding_probability": False}
    plain, learned = (means_by_seed(scene, samples=640, seeds=12, **given) for given in ({}, settings))
    error = np.hypot(plain.std(axis=0, ddof=1), learned.std(axis=0, ddof=1)) / np.sqrt(12)
    assert (4.0 * error <= 0.01 * plain.mean(axis=0)).all()
    assert (np.abs(plain.mean(axis=0) - learned.mean(axis=0)) <= 4.0 * error).all()


def test_learned_light_is_of_strands_of_these_radii() -> None:
    """A saved field is trusted less where anything that light depends on is another."""
    scene, same = fur_scene(ROUND), fur_scene(ROUND)
    assert light_digest(scene) == light_digest(same)
    strands = same.meshes[-1].rounds
    assert strands is not None
    strands.radii = strands.radii * np.float32(2.0)
    assert light_digest(scene) != light_digest(same)
    strands.radii, strands.motion_radii = strands.radii / np.float32(2.0), np.stack([strands.radii, strands.radii])
    assert light_digest(scene) != light_digest(same)
    assert light_digest(scene) != light_digest(fur_scene(RIBBONS))
