# SPDX-License-Identifier: GPL-3.0-or-later
"""Tests of bias where the pixels of a block err together: as many false alarms as are said, and 2% are seen."""

import math
from statistics import NormalDist

import numpy as np
import pytest

from benchmarks.bias import MEAN_LIMIT, detects, find_bias
from benchmarks.block_noise import BLOCK, mean_noise, normal_score, student_score
from tests.helpers.seeded_renders import render_seeds
from tests.helpers.small_scenes import corner_scene

SHAPE = 48, 64
#: Trials of false alarms, and the share of them that is looked for.
TRIALS, LEVEL = 1000, 0.05


def pictures(rng, count, together, spread=0.2):
    """Grey pictures whose pixels err by `spread`, with a share of the variance that is their block's; below 0 the
    block's errors sum to less than independent ones would."""
    height, width = SHAPE
    blocks = rng.normal(size=(count, height // BLOCK, width // BLOCK, 1))
    pixels = rng.normal(size=(count, height // BLOCK, width // BLOCK, BLOCK * BLOCK))
    if together >= 0.0:
        pixels = math.sqrt(1.0 - together) * pixels + math.sqrt(together) * blocks
    else:
        pixels += (math.sqrt(1.0 + together) - 1.0) * pixels.mean(axis=-1, keepdims=True)
    tiles = pixels.reshape(count, height // BLOCK, width // BLOCK, BLOCK, BLOCK).swapaxes(2, 3)
    return np.repeat(1.0 + spread * tiles.reshape(count, height, width, 1), 3, axis=3)


@pytest.mark.parametrize("together", [-0.6, 0.05])
def test_false_alarms_are_as_many_as_said(together):
    """The score of the whole mean, at a level that can be counted: 50 of 1,000 are expected, and 4 standard
    deviations are 28. Pixels taken as independent would give 2 (at -0.6) and 334 (at 0.05)."""
    rng = np.random.default_rng(1)
    limit = NormalDist().inv_cdf(1.0 - LEVEL / 2.0)
    alarms = sum(
        find_bias(pictures(rng, 2, together), pictures(rng, 4, together)).z > limit for _ in range(TRIALS)
    )
    assert alarms == pytest.approx(LEVEL * TRIALS, abs=28)


@pytest.mark.parametrize("together", [-0.6, 0.0, 0.05])
def test_two_percent_are_seen(together):
    rng = np.random.default_rng(2)
    spread = 0.05 if together > 0.0 else 0.15
    sets = [(pictures(rng, 2, together, spread), pictures(rng, 4, together, spread)) for _ in range(50)]
    assert all(find_bias(*one).detectable < 0.02 for one in sets)
    assert np.mean([detects(*one, bias) for one in sets for bias in (-0.02, 0.02)]) > 0.95
    assert not any(find_bias(*one).is_biased for one in sets)


def test_noise_of_renders_is_that_of_their_means():
    """The variance over 48 seeds of a picture's mean, good to a fifth, is what blocks say of it.

    Only edges of this picture are noisy, and within a block they err together: as if they were independent, pixels say
    1.6 times too little.
    """
    images = [image.astype(np.float64) for image in render_seeds(corner_scene((40, 36)), range(48), samples=4)]
    noise = mean_noise(images)
    variance = np.stack([image.mean(axis=(0, 1)) for image in images]).var(axis=0, ddof=1) / len(images)
    assert noise.variance == pytest.approx(variance, rel=0.6)
    assert (noise.variance > 1.3 * noise.of_pixels).all()


def test_student_scores_are_those_of_tables():
    """Two-sided 5%, 1% and 0.1% points of Student's t with 5, 10 and 60 degrees of freedom."""
    for freedom, points in ((5, (2.571, 4.032, 6.869)), (10, (2.228, 3.169, 4.587)), (60, (2.000, 2.660, 3.460))):
        for share, t in zip((0.05, 0.01, 0.001), points, strict=True):
            z = NormalDist().inv_cdf(1.0 - share / 2.0)
            assert normal_score(t, freedom) == pytest.approx(z, rel=0.01)
            # A little too large far out, which makes tests more careful.
            assert t * 0.995 < student_score(z, freedom) < t * 1.025
    assert student_score(MEAN_LIMIT, math.inf) == pytest.approx(MEAN_LIMIT)


def test_blocks_are_found_whichever_row_is_first():
    rng = np.random.default_rng(3)
    images = pictures(rng, 4, 0.3)[:, 4:]
    upside_down = images[:, ::-1]
    for found in (mean_noise(images), mean_noise(upside_down)):
        assert found.variance.sum() > 10.0 * found.of_pixels.sum()
