# SPDX-License-Identifier: GPL-3.0-or-later
"""Noise of pictures: neighbouring pixels err in opposite directions, so that little of it is left in a mean."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.helpers.light_probe import lamp
from tests.helpers.seeded_renders import render_seeds
from tests.helpers.small_scenes import corner_scene

pytestmark = pytest.mark.estimator

SEEDS = 24


def lit_scene():
    """A floor and a wall, lit by a large lamp beside the picture: all noise is of sampling its light."""
    beside = lamp("POINT", (-14.0, 4.0, 4.0), energy=2000.0, radius=3.0)
    return replace(corner_scene((32, 32)), lights=[beside])


def errors(samples):
    """Errors of pixels over seeds, without bias: float64 (SEEDS, height, width)."""
    images = np.stack(render_seeds(lit_scene(), range(SEEDS), samples=samples)).mean(axis=-1).astype(np.float64)
    return images - images.mean(axis=0)


def left_in_means(noise, size):
    """Variance of the means of cells of size x size pixels, over that of as many independent pixels."""
    count, height, width = noise.shape
    means = noise.reshape(count, height // size, size, width // size, size).mean(axis=(2, 4))
    return float((means**2).mean() / (noise**2).mean() * size * size)


@pytest.mark.parametrize("samples, most", [(1, (0.6, 0.5)), (2, (0.75, 0.6)), (4, (0.95, 0.85)), (64, (1.2, 1.0))])
def test_little_noise_is_left_in_means(samples, most):
    """Noise of cells of 2 x 2 and 4 x 4 pixels; with many samples at least no more than if pixels were independent."""
    noise = errors(samples)
    assert left_in_means(noise, 2) < most[0] and left_in_means(noise, 4) < most[1]


def test_of_independent_pixels_more_is_left():
    """The last test can fail: pixels of a picture, each from a seed of its own, are as far off and have no such order.

    Means of 768 quads in 24 pictures: the standard error of their variance is about 1%.
    """
    noise = errors(1)
    row, column = np.mgrid[:32, :32]
    # Within a cell of 4 x 4 no seed is there twice.
    seed = (np.arange(SEEDS)[:, None, None] + 4 * (row % 4) + column % 4) % SEEDS
    mixed = noise[seed, row, column]
    for size in (2, 4):
        assert left_in_means(mixed, size) == pytest.approx(1.0, abs=0.1)
