# SPDX-License-Identifier: GPL-3.0-or-later
"""The filter takes noise out, keeps what its arguments say is detail, and says what it cannot do."""

import itertools
import sys
import time

import numpy as np
import pytest

from engine.denoise import library
from engine.denoise.filter import PREFILTERS, denoise

pytestmark = pytest.mark.skipif(bool(library.problem()), reason="no Open Image Denoise here")

HEIGHT, WIDTH = 60, 90


def noisy_squares(seed=0):
    """Squares of two albedos under even light: truth, noisy picture with alpha, albedo, normal."""
    y, x = np.mgrid[0:HEIGHT, 0:WIDTH]
    albedo = np.where(((x // 15 + y // 15) % 2 == 0)[..., None], (0.8, 0.4, 0.2), (0.1, 0.3, 0.7)).astype(np.float32)
    truth = 2.0 * albedo
    noise = np.random.default_rng(seed).exponential(1.0, (HEIGHT, WIDTH, 1)).astype(np.float32)
    normal = np.zeros_like(truth)
    normal[..., 2] = 1.0
    return truth, np.concatenate((truth * noise, np.ones((HEIGHT, WIDTH, 1), np.float32)), axis=2), albedo, normal


def error(image, truth):
    return float(np.sqrt(np.mean((image - truth) ** 2)))


def test_noise_goes_and_edges_that_the_albedo_shows_stay():
    """Noise of deviation 1 becomes a few percent; without albedo the squares' edges are lost in it."""
    truth, noisy, albedo, normal = noisy_squares()
    before = error(noisy[..., :3], truth)
    alone = error(denoise(noisy), truth)
    helped = error(denoise(noisy, albedo, normal), truth)
    assert alone < 0.5 * before
    assert helped < 0.5 * alone
    assert helped < 0.1 * before


@pytest.mark.parametrize("quality", library.QUALITIES)
@pytest.mark.parametrize("prefilter", PREFILTERS)
def test_every_quality_and_prefilter_takes_noise_out(quality, prefilter):
    truth, noisy, albedo, normal = noisy_squares()
    image = denoise(noisy, albedo, normal, quality=quality, prefilter=prefilter)
    assert image.shape == (HEIGHT, WIDTH, 3) and image.dtype == np.float32
    assert error(image, truth) < 0.2 * error(noisy[..., :3], truth)


def test_the_picture_is_the_same_for_any_number_of_threads_and_any_layout():
    _, noisy, albedo, normal = noisy_squares()
    image = denoise(noisy, albedo, normal, threads=1)
    assert np.array_equal(denoise(noisy, albedo, normal, threads=2), image)
    reversed_rows = np.ascontiguousarray(noisy[::-1])[::-1]
    assert np.array_equal(denoise(reversed_rows, albedo.astype(np.float64), np.asfortranarray(normal)), image)


def test_brightness_does_not_matter():
    _, noisy, albedo, normal = noisy_squares()
    image = denoise(noisy, albedo, normal)
    assert np.allclose(denoise(noisy * 1000.0, albedo, normal), 1000.0 * image, rtol=0.01, atol=0.01)


def test_inputs_are_left_alone():
    _, *images = noisy_squares()
    before = [image.copy() for image in images]
    denoise(*images)
    assert all(np.array_equal(image, copy) for image, copy in zip(images, before, strict=True))


def test_a_cancel_leaves_nothing():
    _, noisy, albedo, normal = noisy_squares()
    assert denoise(noisy, albedo, normal, should_cancel=lambda: True) is None
    asked = []
    assert denoise(noisy, albedo, normal, should_cancel=lambda: asked.append(1)) is not None
    assert asked


def test_a_large_picture_can_be_cancelled_in_the_middle():
    large = np.ones((1080, 1920, 3), np.float32)
    asked = itertools.count(1)
    assert denoise(large, should_cancel=lambda: next(asked) > 3) is None
    assert next(asked) > 4


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"quality": "BEST"}, "quality 'BEST': choose one of HIGH, BALANCED, FAST"),
        ({"prefilter": "SLOW"}, "prefilter 'SLOW': choose one of NONE, FAST, ACCURATE"),
        ({"normal": np.zeros((4, 4, 3), np.float32)}, "needs an albedo"),
        ({"albedo": np.zeros((4, 5, 3), np.float32)}, r"albedo is \(4, 5, 3\)"),
        ({"albedo": np.zeros((4, 4, 1), np.float32)}, r"albedo is \(4, 4, 1\)"),
    ],
)
def test_what_makes_no_sense_is_named(arguments, words):
    with pytest.raises(ValueError, match=words):
        denoise(np.zeros((4, 4, 3), np.float32), **arguments)


@pytest.mark.parametrize("shape", [(1, 1), (3, 1), (0, 5)])
def test_small_pictures_are_no_trouble(shape):
    assert denoise(np.ones((*shape, 3), np.float32)).shape == (*shape, 3)


@pytest.mark.skipif(sys.platform != "linux", reason="counts threads by /proc")
def test_no_more_threads_run_than_are_asked_for():
    """Processor time of one thread is no more than the time on the clock, two of them would take nearly twice."""
    large = np.random.default_rng(0).exponential(1.0, (540, 960, 3)).astype(np.float32)
    start, busy = time.monotonic(), time.process_time()
    denoise(large, threads=1)
    assert time.process_time() - busy < 1.2 * (time.monotonic() - start)
