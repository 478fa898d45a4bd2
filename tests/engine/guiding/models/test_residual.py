# SPDX-License-Identifier: GPL-3.0-or-later
"""How much is kept of what measuring paths found: all that is known, and hardly any noise."""

import numpy as np
import pytest

from engine.guiding.models.residual import OwnNoise, known_residual, residual_error, with_residual

#: Light that paths ended with in a picture of 9 x 16 pixels.
NO_CELLS = np.zeros(9 * 16, np.float32)
NO_NOISE = OwnNoise(NO_CELLS, NO_CELLS)


def film_of(first, second, deviation=0.0):
    """Sums, and the variance of their mean, as of a film: halves (height, width, 3), each with half of the paths."""
    sums = 0.5 * np.concatenate([first.reshape(-1, 3), second.reshape(-1, 3)], axis=1).astype(np.float32)
    return sums, np.broadcast_to(0.5 * np.float32(deviation) ** 2, first.shape[:2]).reshape(-1)


@pytest.mark.parametrize("shape", [(1, 1), (1, 7), (5, 3), (37, 64)])
def test_what_both_halves_agree_on_is_kept_whole(shape):
    image = np.random.default_rng(1).normal(size=(*shape, 3)).astype(np.float32)
    known = known_residual(*film_of(image, image), shape)
    np.testing.assert_allclose(known, image.reshape(-1, 3), rtol=1e-4, atol=1e-5)


def test_of_noise_alone_hardly_anything_is_kept():
    shape = (90, 160)
    rng = np.random.default_rng(2)
    kept = []
    for _ in range(5):
        first, second = rng.normal(size=(2, *shape, 3))
        kept.append((known_residual(*film_of(first, second, 1.0), shape) ** 2).mean())
    # The noise of the mean of both is a half.
    assert np.mean(kept) < 0.01 * 0.5


def test_what_is_lacking_everywhere_is_found_under_noise():
    shape = (90, 160)
    rng = np.random.default_rng(3)
    first, second = 0.3 + rng.normal(size=(2, *shape, 3))
    known = known_residual(*film_of(first, second, 1.0), shape)
    assert known.mean() == pytest.approx(0.3, abs=0.02)
    assert ((known - 0.3) ** 2).mean() < 0.02 * 0.5


def test_a_shape_is_found_as_the_noise_falls():
    """The error falls with the noise: to the noise's own as soon as that is small."""
    shape = (72, 128)
    rows, columns = np.mgrid[: shape[0], : shape[1]]
    truth = np.where((columns > 40) & (columns < 60), 1.0, 0.0)[..., None] + 0.3 * np.sin(rows / 9.0)[..., None]
    truth = np.broadcast_to(truth, (*shape, 3))
    rng = np.random.default_rng(4)
    errors = []
    for deviation in (4.0, 1.0, 0.25, 0.0625):
        first, second = truth + deviation * rng.normal(size=(2, *shape, 3))
        known = known_residual(*film_of(first, second, deviation), shape).reshape(*shape, 3)
        errors.append(((known - truth) ** 2).mean())
        # Never worse than to know nothing, nor than to believe everything.
        assert errors[-1] < 1.1 * min((truth**2).mean(), 0.5 * deviation**2)
    assert errors == sorted(errors, reverse=True)


def test_no_light_is_less_than_none():
    """One pixel lacks less than nothing, in both halves: it is black then, and the others lack the rest alike."""
    image = np.zeros((9, 16, 3), np.float32)
    image[4, 7] = -5.0
    cached = np.full((9 * 16, 3), 0.5, np.float32)
    whole = with_residual(cached, *film_of(image, image), NO_CELLS, (9, 16), NO_NOISE).reshape(9, 16, 3)
    np.testing.assert_array_equal(whole[4, 7], 0.0)
    rest = (9 * 16 * 0.5 - 5.0) / (9 * 16 - 1)
    np.testing.assert_allclose(np.delete(whole.reshape(-1, 3), 4 * 16 + 7, axis=0), rest, atol=1e-4)


def test_light_below_zero_stays_where_the_cached_image_has_some():
    """A lamp of negative strength takes light in one pixel, and what cells lack there is negative as well."""
    cached = np.zeros((9, 16, 3), np.float32)
    cached[2, 3] = -1.0
    lacks = np.zeros((9, 16, 3), np.float32)
    lacks[4, 7] = -5.0
    whole = with_residual(cached.reshape(-1, 3), *film_of(lacks, lacks), NO_CELLS, (9, 16), NO_NOISE).reshape(9, 16, 3)
    np.testing.assert_allclose(whole, cached + lacks, atol=1e-4)


def rare_paths(rng, shape, samples, share, value):
    """Halves and variances of a film whose measuring paths find `value` in a `share` of the cases, and else nothing."""
    found = value * rng.binomial(samples // 2, share, size=(2, *shape, 1))
    halves = np.broadcast_to(2.0 * found / samples, (2, *shape, 3))
    return *halves, (value * found.sum(axis=0) / samples**2).reshape(-1).astype(np.float32)


def test_single_bright_paths_leave_no_patches():
    """One path in a thousand finds a hundred times what a second, even light brings: that one is found, not the specks.

    Every pixel lacks 1 and what the bright paths find, 0.5 on average, so that knowing 1.5 everywhere is right.
    """
    shape, samples = (72, 128), 32
    rng = np.random.default_rng(5)
    first, second, variance = rare_paths(rng, shape, samples, 0.0005, 1000.0)
    noise = rng.normal(size=(2, *shape, 3))
    sums, _ = film_of(1.0 + first + noise[0], 1.0 + second + noise[1])
    known = known_residual(sums, variance + np.float32(0.5), shape)
    assert known.mean() == pytest.approx((1.0 + 0.5 * (first + second)).mean(), rel=0.05)
    # 1.6% of the pixels have a bright path, which is 31 there.
    assert known.max() < 5.0
    assert ((known - 1.5) ** 2).mean() < 0.005


def test_where_few_paths_measure_nothing_is_lost():
    """A pixel without a path that found something is not taken for one that lacks nothing."""
    shape = (72, 128)
    rng = np.random.default_rng(6)
    known = [
        known_residual(sums, variance, shape).mean()
        for first, second, variance in (rare_paths(rng, shape, 64, 0.03, 10.0) for _ in range(4))
        for sums, _ in [film_of(first, second)]
    ]
    assert np.mean(known) == pytest.approx(0.3, rel=0.03)


def test_single_bright_paths_do_not_make_a_lie_certain():
    """Where bright paths lack as much as others exceed, the cells are right, and the standard error says as much."""
    shape, samples = (72, 128), 8
    surest = []
    for seed in range(20):
        rng = np.random.default_rng(seed)
        sign = rng.choice((-1.0, 1.0), size=(*shape, 1))
        first, second, variance = rare_paths(rng, shape, samples, 0.0002, 1000.0)
        sums, _ = film_of(sign * first, sign * second)
        error = residual_error(sums, variance, shape, np.ones(sign.size, np.float32))
        surest.append(error.wide_squared / error.wide_noise)
    # Were the error that of as much noise evenly spread, the largest of them would be 2.3.
    assert max(surest) < 1.5


def test_a_lie_in_the_large_is_certain():
    shape = (72, 128)
    rng = np.random.default_rng(7)
    first, second = 0.5 + rng.normal(size=(2, *shape, 3))
    error = residual_error(*film_of(first, second, 1.0), shape, np.ones(72 * 128, np.float32))
    assert error.wide_squared == pytest.approx(0.25, rel=0.1)
    assert error.wide_squared > 8.0 * error.wide_noise


def test_wide_bands_whose_noise_nobody_sees_are_kept_though_nothing_is_sure():
    """A tenth of a pixel's noise lacks everywhere; an image's mean is too noisy to be sure of it, but not too noisy."""
    shape = (24, 32)
    rng = np.random.default_rng(8)
    found, even = [], np.ones(24 * 32)
    for _ in range(40):
        first, second = 0.1 + 4.0 * rng.normal(size=(2, *shape, 3))
        sums, variance = film_of(first, second, 4.0)
        sure = known_residual(sums, variance, shape)
        known = known_residual(sums, variance, shape, OwnNoise(4.0 * even, even))
        found.append((sure.mean(), known.mean(), (known**2).mean()))
    sure, known, square = np.mean(found, axis=0)
    assert sure < 0.05 and known == pytest.approx(0.1, abs=0.05)
    # Two fifteenths of the image's noise, and what is lacking.
    assert square < 4.0 / 6.0
