# SPDX-License-Identifier: GPL-3.0-or-later
"""How much is kept of what measuring paths found: all that is known, and hardly any noise."""

import numpy as np
import pytest

from engine.guiding.models.residual import known_residual, with_residual


def sums_of(first, second):
    """What a film holds, of two halves (height, width, 3), each with half of the paths."""
    return 0.5 * np.concatenate([first.reshape(-1, 3), second.reshape(-1, 3)], axis=1).astype(np.float32)


@pytest.mark.parametrize("shape", [(1, 1), (1, 7), (5, 3), (37, 64)])
def test_what_both_halves_agree_on_is_kept_whole(shape):
    image = np.random.default_rng(1).normal(size=(*shape, 3)).astype(np.float32)
    known = known_residual(sums_of(image, image), shape)
    np.testing.assert_allclose(known, image.reshape(-1, 3), rtol=1e-4, atol=1e-5)


def test_of_noise_alone_hardly_anything_is_kept():
    shape = (90, 160)
    rng = np.random.default_rng(2)
    kept = []
    for _ in range(5):
        first, second = rng.normal(size=(2, *shape, 3))
        kept.append((known_residual(sums_of(first, second), shape) ** 2).mean())
    # The noise of the mean of both is a half.
    assert np.mean(kept) < 0.01 * 0.5


def test_what_is_lacking_everywhere_is_found_under_noise():
    shape = (90, 160)
    rng = np.random.default_rng(3)
    first, second = 0.3 + rng.normal(size=(2, *shape, 3))
    known = known_residual(sums_of(first, second), shape)
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
        known = known_residual(sums_of(first, second), shape).reshape(*shape, 3)
        errors.append(((known - truth) ** 2).mean())
        # Never worse than to know nothing, nor than to believe everything.
        assert errors[-1] < 1.1 * min((truth**2).mean(), 0.5 * deviation**2)
    assert errors == sorted(errors, reverse=True)


def test_no_light_is_less_than_none():
    """One pixel lacks less than nothing, in both halves: it is black then, and the others stay as they are."""
    image = np.zeros((9, 16, 3), np.float32)
    image[4, 7] = -5.0
    whole = with_residual(np.full((9 * 16, 3), 0.5, np.float32), sums_of(image, image), (9, 16)).reshape(9, 16, 3)
    np.testing.assert_array_equal(whole[4, 7], 0.0)
    np.testing.assert_allclose(np.delete(whole.reshape(-1, 3), 4 * 16 + 7, axis=0), 0.5, atol=1e-4)
