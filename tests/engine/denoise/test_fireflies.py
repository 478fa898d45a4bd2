# SPDX-License-Identifier: GPL-3.0-or-later
"""Fireflies are cut to what is around them allows; what is surely there, or the surface's own, stays."""

import numpy as np
import pytest

from engine.denoise.fireflies import without_fireflies

GREY = (0.5, 0.5, 0.5)
FLY = (20.0, 10.0, 6.0)


def picture(*places, color=FLY, size=(90, 110)):
    """A grey picture with bright pixels, and variances as of one sample in all that made them bright."""
    image = np.full((*size, 3), GREY, np.float32)
    for place in places:
        image[place] = color
    return image, np.square(image - np.float32(0.5)) + np.float32(1e-4)


@pytest.mark.parametrize("places", [[(4, 5)], [(0, 0)], [(1, 1)], [(89, 109), (89, 108)], [(4, 5), (5, 5)]])
def test_a_firefly_is_cut_to_four_times_what_is_around_it_and_keeps_its_hue(places):
    image, variance = picture(*places)
    found = without_fireflies(image, variance)
    for place in places:
        assert found[place] == pytest.approx(np.array(FLY) * (4.0 * 0.5 / 12.0), rel=1e-5)
        image[place] = found[place]
    assert np.array_equal(found, image)


def test_what_is_sure_stays():
    """A lamp of one pixel, which all samples find, and one that is sure to be half as bright as it seems."""
    image, variance = picture((4, 5))
    variance[4, 5] = 0.01
    assert without_fireflies(image, variance)[4, 5] == pytest.approx(FLY, rel=0.02)
    variance[4, 5] = 3.0**2
    assert without_fireflies(image, variance)[4, 5] == pytest.approx(np.array(FLY) * 0.5, rel=1e-5)


def test_no_more_than_a_hundredth_of_the_light_is_lost():
    """Where few samples find all light, it is in fireflies alone."""
    places = [(row, column) for row in range(3, 90, 8) for column in range(3, 110, 8)]
    image, variance = picture(*places)
    found = without_fireflies(image, variance)
    assert found.sum(dtype=np.float64) == pytest.approx(0.99 * image.sum(dtype=np.float64), rel=1e-5)
    cut = [found[place].mean() / image[place].mean() for place in places]
    assert np.allclose(cut, cut[0]) and cut[0] < 1.0


def test_what_the_surface_or_three_more_pixels_show_stays():
    image, variance = picture((4, 5))
    albedo = np.full_like(image, 0.1)
    albedo[4, 5] = 0.8
    assert np.array_equal(without_fireflies(image, variance, albedo), image)
    image, variance = picture((4, 5), (4, 6), (5, 5), (5, 6))
    assert np.array_equal(without_fireflies(image, variance), image)


@pytest.mark.parametrize("size", [(0, 0), (1, 1), (1, 4), (2, 2), (3, 1)])
def test_the_smallest_pictures_come_back(size):
    image, variance = picture(size=size)
    assert np.array_equal(without_fireflies(image, variance), image)


def test_alpha_is_left_out_and_what_is_no_number_is_left_alone():
    image, variance = picture((1, 1))
    image[6, 8] = np.nan
    image[6, 3] = np.inf
    found = without_fireflies(np.concatenate((image, image[..., :1]), axis=2), variance)
    assert found.shape == image.shape
    assert np.isnan(found[6, 8]).all() and np.isinf(found[6, 3]).all()
    assert found[1, 1] == pytest.approx(np.array(FLY) / 6.0, rel=1e-5)
