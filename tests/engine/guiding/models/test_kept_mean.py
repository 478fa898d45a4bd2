# SPDX-License-Identifier: GPL-3.0-or-later
"""The mean of a picture with a radiance cache is that of all paths, whatever bands keep and black cuts."""

from functools import partial

import numpy as np
import pytest

from engine.guiding.models.kept_mean import sure_mean, with_mean
from engine.guiding.models.residual import OwnNoise, with_relative_residual, with_residual

SHAPE = (27, 48)
PIXELS = SHAPE[0] * SHAPE[1]


def skewed(seed):
    """A cached image, dark on the left, and halves of what it lacks: 0 on average, found by one path in fifty."""
    rng = np.random.default_rng(seed)
    cached = np.full((PIXELS, 3), 0.5, np.float32)
    cached[np.arange(PIXELS) % SHAPE[1] < 24] = 0.02
    found = np.where(rng.random((PIXELS, 2, 1)) < 0.02, 4.9, -0.1) * cached[:, None, :]
    halves = 0.5 * found.astype(np.float32)
    return cached, halves.reshape(PIXELS, 6), (halves**2).mean(axis=2).sum(axis=1), cached.mean(axis=1)


NOISE = OwnNoise(np.ones(PIXELS, np.float32), np.ones(PIXELS, np.float32))


@pytest.mark.parametrize("mended", [partial(with_residual, own=NOISE), partial(with_relative_residual, own=NOISE)])
def test_nothing_is_lost_or_won_on_average(mended):
    for seed in range(3):
        cached, sums, variance, ended = skewed(seed)
        whole = mended(cached, sums, variance, ended, SHAPE)
        expected = cached.mean(axis=0) + sums[:, :3].mean(axis=0) + sums[:, 3:].mean(axis=0)
        np.testing.assert_allclose(whole.mean(axis=0), expected, rtol=1e-5)
        assert whole.min() >= 0.0


@pytest.mark.parametrize("mended", [with_residual, with_relative_residual])
def test_a_single_bright_path_does_not_light_the_whole_picture(mended):
    """As one through water to a small sun, which no other path finds: a scene came out twice as bright."""
    cached = np.full((PIXELS, 3), 0.5, np.float32)
    sums, variance = np.zeros((PIXELS, 6), np.float32), np.zeros(PIXELS, np.float32)
    sums[100, :3] = 0.5 * PIXELS
    variance[100] = sums[100, 0] ** 2
    own = OwnNoise(np.full(PIXELS, 0.02, np.float32), np.ones(PIXELS, np.float32))
    whole = mended(cached, sums, variance, cached.mean(axis=1), SHAPE, own)
    others = np.delete(whole, 100, axis=0)
    assert np.mean((others / 0.5 - 1.0) ** 2) < 0.1 * 0.02


def test_a_mean_is_believed_once_it_is_sure():
    image = np.full((10, 3), 0.5)
    measured = np.full(3, 1.0)
    for noise, low, high in ((0.25, 0.0, 0.0), (0.25 / 25.0, 0.8, 1.0), (0.25 / 1e4, 0.999, 1.0), (0.0, 1.0, 1.0)):
        kept = (sure_mean(image, measured, noise, 0.0) - 0.5) / 0.5
        assert low <= kept.min() <= kept.max() <= high + 1e-12
    # Noise that nobody sees is no reason to doubt.
    np.testing.assert_allclose(sure_mean(image, measured, 0.25, 1.0), measured)


def test_light_that_is_no_cells_stays():
    image = np.ones((8, 3), np.float32)
    image[4:] = 100.0
    ended = np.where(np.arange(8) < 4, np.float32(0.5), np.float32(0.0))
    whole = with_mean(image, image.mean(axis=0) + np.array([0.1, 0.0, -0.1]), ended)
    np.testing.assert_array_equal(whole[4:], image[4:])
    np.testing.assert_allclose(whole[:4], np.broadcast_to([1.2, 1.0, 0.8], (4, 3)), rtol=1e-5)


def test_light_below_zero_is_mended_as_light_above():
    image = np.random.default_rng(7).random((9, 3)).astype(np.float32)
    mean, ended = image.mean(axis=0) + 0.05, image.mean(axis=1)
    np.testing.assert_allclose(with_mean(-image, -mean, -ended), -with_mean(image, mean, ended), rtol=1e-6)


def test_no_light_is_less_than_none():
    image = np.full((4, 3), 0.25, np.float32)
    np.testing.assert_array_equal(with_mean(image, np.full(3, -1.0), np.ones(4, np.float32)), 0.0)


def test_black_stays_where_cells_say_nothing():
    image = np.zeros((4, 3), np.float32)
    np.testing.assert_array_equal(with_mean(image, np.ones(3), np.zeros(4, np.float32)), 0.0)
