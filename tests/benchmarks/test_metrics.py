# SPDX-License-Identifier: GPL-3.0-or-later
"""The yardstick itself: metrics against closed forms, and the picture comparison against planted differences."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from benchmarks import images, metrics
from benchmarks.picture_means import grid_edges


def gaussian_renders(mean: np.ndarray, deviation: float, seeds: range) -> list[np.ndarray]:
    return [mean + np.random.default_rng(seed).normal(0.0, deviation, mean.shape) for seed in seeds]


def test_relative_squared_error_is_scale_free_and_matches_its_formula() -> None:
    reference = np.full((10, 10, 3), 4.0)
    image = reference * 1.5
    expected = 0.5**2 / (1.0 + metrics.EPSILON)
    error = metrics.relative_squared_error(image, reference)
    assert error.whole == pytest.approx(expected)
    assert error.trimmed == pytest.approx(expected)
    assert metrics.relative_squared_error(image * 1000, reference * 1000).whole == pytest.approx(expected)


def test_trimming_leaves_out_the_worst_tenth_of_a_percent() -> None:
    per_pixel = np.zeros((50, 100))
    per_pixel[7, 3:8] = 1e6  # 5 of 5000
    error = metrics.reduce_error(per_pixel)
    assert error.whole == pytest.approx(1000.0)
    assert error.trimmed == 0.0
    per_pixel[9, 9] = 1.0
    assert metrics.reduce_error(per_pixel).trimmed == pytest.approx(1.0 / 4995)


def test_seed_variance_estimates_the_expected_error_and_ignores_bias() -> None:
    reference = np.full((40, 40, 3), 2.0)
    biased = gaussian_renders(reference + 1.0, 0.2, range(4))
    # sigma / mean = 0.1; 4800 values with 3 degrees of freedom: standard error 1.2%, five of them allowed.
    expected = 0.1**2 / (1.0 + metrics.EPSILON)
    assert metrics.seed_variance(biased, reference).whole == pytest.approx(expected, rel=0.06)
    assert metrics.relative_squared_error(biased[0], reference).whole > 20 * expected


def test_seed_variance_refuses_two_seeds() -> None:
    with pytest.raises(ValueError, match="at least 3 seeds"):
        metrics.seed_variance([np.ones((2, 2, 3))] * 2, np.ones((2, 2, 3)))


def test_absolute_percentage_error() -> None:
    reference = np.full((4, 4, 3), 8.0)
    assert metrics.absolute_percentage_error(reference * 0.75, reference) == pytest.approx(0.25 / 1.01)


def test_flip_is_zero_for_equal_images_and_grows_with_noise() -> None:
    pytest.importorskip("flip_evaluator")
    reference = np.random.default_rng(1).uniform(0.2, 2.0, (32, 32, 3)).astype(np.float32)
    noise = np.random.default_rng(2).normal(0.0, 1.0, reference.shape)
    assert metrics.flip(reference, reference) == pytest.approx(0.0, abs=1e-6)
    assert 0.0 < metrics.flip(reference + 0.02 * noise, reference) < metrics.flip(reference + 0.3 * noise, reference)


def test_equal_renderers_pass_the_cell_comparison_and_a_planted_cell_fails_it() -> None:
    mean = np.random.default_rng(3).uniform(0.5, 1.5, (64, 96, 3))
    a, b = gaussian_renders(mean, 0.05, range(3)), gaussian_renders(mean, 0.05, range(10, 13))
    comparison = metrics.compare_cells(a, b)
    assert comparison.difference.shape == (8, 8)
    assert not comparison.exceeds(0.02, 4.0).any()
    # Standard errors are honest: the differences are unit normals in them (64 values: 1 +- 0.09, four of those).
    assert (comparison.difference / comparison.standard_error).std() == pytest.approx(1.0, abs=0.36)
    for image in a:
        image[8:16, 24:36] *= 1.05
    exceeding = metrics.compare_cells(a, b).exceeds(0.02, 4.0)
    assert exceeding[1, 2]
    assert exceeding.sum() == 1


def test_mean_comparison_sees_half_a_percent_in_one_channel() -> None:
    mean = np.random.default_rng(4).uniform(0.5, 1.5, (64, 96, 4))
    a, b = gaussian_renders(mean, 0.05, range(3)), gaussian_renders(mean, 0.05, range(10, 13))
    for image in a:
        image[..., 1] *= 1.005
    difference, error = metrics.compare_means(a, b)
    assert difference[1] == pytest.approx(0.005, abs=4 * error[1])
    assert error[1] < 0.001
    assert np.all(np.abs(difference[[0, 2, 3]]) < 4 * error[[0, 2, 3]])


def test_grid_covers_small_images_without_empty_cells() -> None:
    for size in (1, 5, 8, 63):
        edges = grid_edges(size, 8)
        assert edges[0] == 0
        assert edges[-1] == size
        assert np.all(np.diff(edges) > 0)


@pytest.mark.parametrize("channel_count", [3, 4])
def test_exr_round_trip(tmp_path: Path, channel_count: int) -> None:
    pixels = np.random.default_rng(5).normal(0.0, 100.0, (5, 7, channel_count)).astype(np.float32)
    images.write_exr(tmp_path / "a.exr", pixels)
    back, _ = images.read_exr(tmp_path / "a.exr")
    np.testing.assert_array_equal(back, pixels)
    with pytest.raises(ValueError, match="no layer"):
        images.read_exr(tmp_path / "a.exr", "Normal")


def test_tone_map_is_the_srgb_curve() -> None:
    ramp = np.array([[[0.0, 0.2159, 5.0]]], np.float32)
    np.testing.assert_array_equal(images.tone_map(ramp), [[[0, 128, 255]]])
    np.testing.assert_array_equal(images.tone_map(ramp, 0.0), [[[0, 0, 0]]])


def test_signed_difference_colours() -> None:
    reference = np.ones((1, 3, 3), np.float32)
    image = reference * np.array([1.0, 2.0, 0.0], np.float32)[None, :, None]
    colours = images.signed_difference(image, reference, 0.25)
    np.testing.assert_array_equal(colours[0], [[255, 255, 255], [255, 0, 0], [0, 0, 255]])


def test_pixels_in_which_a_reference_is_not_known_count_in_no_figure() -> None:
    rng = np.random.default_rng(3)
    reference = rng.uniform(0.5, 1.5, (12, 10, 3)).astype(np.float32)
    images = [(reference + rng.normal(0.0, 0.1, reference.shape)).astype(np.float32) for _ in range(3)]
    partly = reference.copy()
    partly[:, 6:] = np.nan
    spoiled = [np.concatenate([image[:, :6], 9.0 * image[:, 6:]], axis=1) for image in images]
    left = [image[:, :6] for image in images]
    assert not metrics.known_pixels(partly)[:, 6:].any() and metrics.known_pixels(partly)[:, :6].all()
    for figure in (metrics.relative_squared_error, metrics.percentage_error):
        assert figure(spoiled[0], partly) == figure(left[0], reference[:, :6])
    assert metrics.seed_variance(spoiled, partly) == metrics.seed_variance(left, reference[:, :6])
    assert metrics.seed_deviations(spoiled, partly) == metrics.seed_deviations(left, reference[:, :6])
    assert metrics.flip(spoiled[0], partly) == pytest.approx(
        metrics.flip(np.where(np.isnan(partly), 0.0, images[0]), partly)
    )
