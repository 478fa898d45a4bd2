# SPDX-License-Identifier: GPL-3.0-or-later
"""Radii within which photons are gathered: large where light is smooth, small where it is sharp."""

from __future__ import annotations

import numpy as np
import pytest

from engine.array_types import Float32Array, FloatArray
from engine.render.photon_radius import (
    BIAS_COUNTS,
    MOST_NEIGHBOURS,
    best_radius,
    neighbours_within,
    radius_of_neighbours,
)
from engine.state.photons import PHOTON_P, PHOTON_POWER, PHOTON_WIDTH


def photons_at(places: FloatArray) -> Float32Array:
    """Photons of a power of 1 on the plane z = 0."""
    photons = np.zeros((len(places), PHOTON_WIDTH), np.float32)
    photons[:, PHOTON_P : PHOTON_P + 2] = places
    photons[:, PHOTON_POWER : PHOTON_POWER + 3] = 1.0
    return photons


def test_neighbours_lie_within_the_radius() -> None:
    photons = photons_at(np.random.default_rng(1).random((20_000, 2)))
    for neighbours in (8, 16, 64):
        radius = radius_of_neighbours(photons, neighbours, 1.0)
        assert 20_000 * np.pi * radius**2 == pytest.approx(neighbours, rel=0.15)


def test_so_many_photons_lie_within_a_radius() -> None:
    photons = photons_at(np.random.default_rng(1).random((20_000, 2)))
    for radius in (0.01, 0.04):
        assert neighbours_within(photons, radius, 1.0) == pytest.approx(20_000 * np.pi * radius**2, rel=0.15)
    assert neighbours_within(photons[:1], 0.1, 1.0) == 0.0


@pytest.mark.parametrize("few", [0, 1])
def test_without_neighbours_the_radius_goes_by_the_casters(few: int) -> None:
    assert best_radius(photons_at(np.zeros((few, 2))), 4.0) == pytest.approx(0.1)


def test_photons_in_one_place_have_a_radius_too() -> None:
    assert best_radius(photons_at(np.zeros((1000, 2))), 4.0) > 0.0


def test_even_light_has_large_discs() -> None:
    photons = photons_at(np.random.default_rng(2).random((20_000, 2)))
    assert best_radius(photons, 1.0) > 0.75 * radius_of_neighbours(photons, MOST_NEIGHBOURS, 1.0)


@pytest.mark.parametrize("count", [10_000, 20_000, 60_000])
def test_a_bright_line_has_the_radius_of_least_error(count: int) -> None:
    """Light that falls off as a Gaussian across a line: integrals say what a disc does to it."""
    deviation = 0.005
    numbers = np.random.default_rng(3)
    places = np.stack([numbers.normal(0.0, deviation, count), numbers.random(count)], axis=1)
    x = np.linspace(-6.0, 6.0, 4001) * deviation
    density = np.exp(-0.5 * (x / deviation) ** 2) / (deviation * np.sqrt(2.0 * np.pi))
    # A disc's mean is off by r^2 / 8 times the second derivative. Places are asked as photons lie.
    bias = (density * (density * ((x / deviation) ** 2 - 1.0) / deviation**2 / 8.0) ** 2).sum()
    noise = (density**2).sum() / (np.pi * count)
    expected = (noise / (2.0 * BIAS_COUNTS * bias)) ** (1.0 / 6.0)
    assert best_radius(photons_at(places), 1.0) == pytest.approx(expected, rel=0.25)
