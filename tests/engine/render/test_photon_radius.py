# SPDX-License-Identifier: GPL-3.0-or-later
"""Radii within which photons are gathered: large where light is smooth, small where it is sharp."""

from __future__ import annotations

import numpy as np
import pytest

from engine.array_types import Float32Array, FloatArray
from engine.render.photon_radius import MOST_NEIGHBOURS, best_radius, radius_of_neighbours
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


@pytest.mark.parametrize("few", [0, 1])
def test_without_neighbours_the_radius_goes_by_the_casters(few: int) -> None:
    assert best_radius(photons_at(np.zeros((few, 2))), 4.0) == pytest.approx(0.1)


def test_photons_in_one_place_have_a_radius_too() -> None:
    assert best_radius(photons_at(np.zeros((1000, 2))), 4.0) > 0.0


def test_even_light_has_large_discs() -> None:
    photons = photons_at(np.random.default_rng(2).random((20_000, 2)))
    assert best_radius(photons, 1.0) > 0.75 * radius_of_neighbours(photons, MOST_NEIGHBOURS, 1.0)


@pytest.mark.parametrize("count", [5_000, 20_000])
def test_a_bright_line_has_the_radius_of_least_error(count: int) -> None:
    """Light that falls off as a Gaussian of standard deviation s across a line.

    The mean square of its relative second derivative, weighed as photons lie, gives the best radius by Silverman 1986,
    Eq. (4.14): (noise / (2 bias))^(1/6).
    """
    deviation = 0.02
    numbers = np.random.default_rng(3)
    places = np.stack([numbers.normal(0.0, deviation, count), numbers.random(count)], axis=1)
    # Exactly, by integrals over discs: f'' weighs x^2 with r^2 / 8 after averaging over a disc.
    x = np.linspace(-6.0, 6.0, 4001) * deviation
    density = np.exp(-0.5 * (x / deviation) ** 2) / (deviation * np.sqrt(2.0 * np.pi))
    curvature = density * ((x / deviation) ** 2 - 1.0) / deviation**2
    # Squares, weighed by how many photons ask there.
    bias = np.trapezoid(density * (curvature / 8.0) ** 2, x) if hasattr(np, "trapezoid") else np.trapz(
        density * (curvature / 8.0) ** 2, x
    )
    step = x[1] - x[0]
    squared_light, light = (density**3).sum() * step, (density**2).sum() * step
    noise = light / (np.pi * count)
    expected = (noise / (2.0 * bias)) ** (1.0 / 6.0)
    assert squared_light > 0.0
    assert best_radius(photons_at(places), 1.0) == pytest.approx(expected, rel=0.35)


def test_radii_fall_with_the_number_of_photons_where_light_is_sharp() -> None:
    numbers = np.random.default_rng(4)

    def radius(count: int) -> float:
        places = np.stack([numbers.normal(0.0, 0.01, count), numbers.random(count)], axis=1)
        return best_radius(photons_at(places), 1.0)

    assert radius(4_000) / radius(30_000) == pytest.approx((30_000 / 4_000) ** (1 / 6), rel=0.2)
