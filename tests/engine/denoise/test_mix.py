# SPDX-License-Identifier: GPL-3.0-or-later
"""A mix of a denoised picture and its samples errs less than either, and converges to the samples."""

import numpy as np
import pytest

from engine.denoise import mix
from engine.denoise.mix import added_noise
from engine.denoise.windows import window_means

#: Contrast of the texture, which the denoiser blurs: about what it errs by there.
CONTRAST = 0.2


def pictures(noise, seed=1, size=(60, 80)):
    """What is true (a texture on the right, a slope on the left), a picture that is blurred, samples and variance."""
    rng = np.random.default_rng(seed)
    row, column = np.indices(size)
    texture = np.where(column >= size[1] // 2, CONTRAST * ((row // 2 + column // 2) % 2), 0.0)
    true = (np.array((0.5, 1.0, 0.25)) * (0.5 + 0.01 * row + texture)[..., None]).astype(np.float32)
    sampled = (true + noise * rng.normal(size=true.shape)).astype(np.float32)
    return true, window_means(true, 2), sampled, np.full_like(true, noise * noise)


def mixed(denoised, sampled, variance, through=0.0):
    """By a denoiser that lets such a share of noise through."""
    with np.errstate(invalid="ignore"):
        added = added_noise(sampled[..., :3], variance)
        return mix.mixed(denoised, sampled, variance, added, denoised + np.float32(through) * added)


def error(picture, true):
    return float(np.square(picture.astype(np.float64) - true).mean())


@pytest.mark.parametrize("seed", [1, 2, 3])
@pytest.mark.parametrize("noise", [0.06, 0.03, 0.015, 0.005])
def test_it_errs_less_than_both(noise, seed):
    true, denoised, sampled, variance = pictures(noise, seed)
    best = min(error(denoised, true), error(sampled, true))
    assert error(mixed(denoised, sampled, variance), true) < 0.9 * best


@pytest.mark.parametrize("seed", [1, 2, 3])
@pytest.mark.parametrize(("noise", "through"), [(0.03, 0.4), (0.03, 0.7), (0.015, 0.4)])
def test_noise_that_the_denoiser_lets_through_is_known(through, noise, seed):
    """What it leaves of noise and what it errs by hide each other in the difference to the samples."""
    true, blurred, sampled, variance = pictures(noise, seed)
    denoised = blurred + np.float32(through) * (sampled - blurred)
    found = error(mixed(denoised, sampled, variance, through), true)
    assert found < 0.995 * error(mixed(denoised, sampled, variance), true)
    assert found < 0.98 * min(error(denoised, true), error(sampled, true))


def test_added_noise_is_half_of_what_there_is_and_goes_nowhere_below_black():
    _, _, sampled, variance = pictures(0.1)
    sampled[:20] *= np.float32(0.1)
    sampled[0, 0, 1], variance[0, 1, 2] = np.nan, np.inf
    added = added_noise(sampled, variance)
    assert added.dtype == np.float32 and np.array_equal(added, added_noise(sampled, variance))
    assert not added[0, :2].any()
    assert np.allclose(np.abs(added[1:]), 0.05)
    assert (added == added[..., :1]).all()
    assert 0.4 < (added[20:] > 0.0).mean() < 0.6
    dark = (sampled < 0.05).any(axis=2) & np.isfinite(sampled).all(axis=2)
    assert dark[1:].any() and (added[1:][dark[1:]] > 0.0).all()


@pytest.mark.parametrize("noise", [0.3, 1.0, 10.0])
def test_where_noise_is_more_than_the_denoiser_errs_it_is_the_denoised_picture(noise):
    true, denoised, sampled, variance = pictures(noise)
    found = mixed(denoised, sampled, variance)
    assert error(found, true) < error(denoised, true) + 0.01 * noise * noise
    assert (found == denoised).all(axis=2).mean() > 0.7


def test_it_converges_to_the_samples():
    """What noise and denoiser leave is ever less beside the denoiser's error, and ever nearer to the noise."""
    for noise in (1e-2, 1e-3, 1e-4):
        true, denoised, sampled, variance = pictures(noise)
        found = mixed(denoised, sampled, variance)
        assert error(found, true) < 1.01 * error(sampled, true)
    texture = np.s_[:, 45:]
    assert np.abs(found - sampled)[texture].max() < 1e-5
    assert np.abs(denoised - sampled)[texture].max() > 0.05


def test_what_has_no_noise_is_as_it_was_sampled():
    true, denoised, _, variance = pictures(0.0)
    assert np.allclose(mixed(denoised, true, variance), true, rtol=0.0, atol=1e-6)


def test_of_noise_alone_hardly_any_comes_back():
    true, _, sampled, variance = pictures(0.1)
    assert error(mixed(true, sampled, variance), true) < 0.02 * error(sampled, true)


@pytest.mark.parametrize("light", [10.0, 1e6, 1e15])
def test_fireflies_stay_out(light):
    """A pixel with one sample that is very bright: its variance says so, and the pixels around are left alone too."""
    _, denoised, sampled, variance = pictures(0.01)
    apart = mixed(denoised, sampled, variance)
    sampled[20, 10] += np.float32(light)
    variance[20, 10] = np.float32(light) ** 2
    found = mixed(denoised, sampled, variance)
    assert np.array_equal(found[18:23, 8:13], denoised[18:23, 8:13])
    found[17:24, 7:14] = apart[17:24, 7:14]
    assert np.array_equal(found, apart)


@pytest.mark.parametrize("bad", [np.nan, np.inf])
@pytest.mark.parametrize("which", ["denoised", "sampled", "variance"])
def test_what_is_no_number_is_as_it_was_denoised(which, bad):
    true, denoised, sampled, variance = pictures(0.01)
    {"denoised": denoised, "sampled": sampled, "variance": variance}[which][30, 60] = bad
    found = mixed(denoised, sampled, variance)
    assert np.array_equal(found[30, 60], denoised[30, 60], equal_nan=True)
    rest = np.ones(found.shape[:2], bool)
    rest[30, 60] = False
    assert np.isfinite(found[rest]).all()
    assert error(found[rest], true[rest]) < 0.9 * error(window_means(true, 2)[rest], true[rest])


@pytest.mark.parametrize("size", [(1, 1), (1, 7), (7, 1), (2, 3), (60, 80)])
def test_pictures_that_are_mixed_in_parts_have_no_seams(size, monkeypatch):
    _, denoised, sampled, variance = pictures(0.02, size=size)
    whole = mixed(denoised, sampled, variance)
    assert whole.shape == denoised.shape and whole.dtype == np.float32
    for rows in (1, 2, 7):
        monkeypatch.setattr(mix, "PIXELS_AT_ONCE", rows * size[1])
        assert np.array_equal(mixed(denoised, sampled, variance), whole)


def test_further_channels_are_left_out():
    _, denoised, sampled, variance = pictures(0.02)
    with_alpha = np.concatenate((sampled, np.ones((*sampled.shape[:2], 1), np.float32)), axis=2)
    assert np.array_equal(mixed(denoised, with_alpha, variance), mixed(denoised, sampled, variance))
