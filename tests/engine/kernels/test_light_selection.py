# SPDX-License-Identifier: GPL-3.0-or-later
"""Regions that choose among clusters: what they choose has the probability that hits are weighed with."""

from __future__ import annotations

import numpy as np
import pytest

import tests.helpers.light_probe as probe
from engine.scene.description import World
from engine.state.lights import HEADER_CLUSTERS
from tests.helpers.chi2 import cell_integrals, histogram, p_value, sidak

UP = (0.0, 0.0, 1.0)
PLACE = (0.3, -0.2, 0.1)


def _lamps(count: int) -> list:
    generator = np.random.default_rng(5)
    return [
        probe.lamp("AREA", (*generator.uniform(-8, 8, 2), generator.uniform(1, 6)), energy=generator.uniform(1, 100))
        for _ in range(count)
    ]


def _learned(lights, least=1e-4):
    """Uneven probabilities, some clusters next to never: none less than `least` of the likeliest."""
    probability = np.random.default_rng(6).random(lights.header[HEADER_CLUSTERS]) ** 4 + least
    return probe.with_selection(lights, probability)


def test_probabilities_are_those_of_the_picks() -> None:
    """For evenly spaced random numbers frequencies match, and the returned probability is the forward one."""
    lamps = [*_lamps(200), probe.lamp("SUN", angle=0.1), probe.lamp("SUN")]
    lights, _ = probe.build(probe.make_description(lamps))
    learned = _learned(lights)
    p, n = np.array([PLACE], np.float32), np.array([UP], np.float32)
    forward = probe.pmfs(learned, p, n)[0]
    assert forward.sum() == pytest.approx(1.0, abs=1e-3)
    assert np.abs(forward - probe.pmfs(lights, p, n)[0]).max() > 0.01
    emitters, pmf = probe.picks(learned, PLACE, UP, (np.arange(200_000) + 0.5) / 200_000)
    assert (emitters >= 0).all()
    assert np.allclose(pmf, forward[emitters], rtol=3e-3)
    counts = np.bincount(emitters, minlength=len(forward)) / len(emitters)
    assert np.abs(counts - forward).max() < 3e-4


def test_outside_all_regions_the_tree_chooses() -> None:
    lights, _ = probe.build(probe.make_description(_lamps(60)))
    far, n = np.array([(0.0, 0.0, -150.0)], np.float32), np.array([UP], np.float32)
    assert (probe.pmfs(_learned(lights), far, n) == probe.pmfs(lights, far, n)).all()


@pytest.mark.parametrize("size", [(16, 32), (5, 11), (40, 100)])
def test_patches_are_sampled_by_their_density(size: tuple[int, int]) -> None:
    """Chi-square at a significance of 1e-3 over the family, with a sun on the border of two patches."""
    sky = np.random.default_rng(7).random((*size, 3)).astype(np.float32) ** 4
    sky[size[0] // 2, size[1] // 2] = 60.0
    lights, geometry = probe.build(probe.make_description(world=World("w", "World", None)), background=sky)
    learned = _learned(lights)
    samples = probe.draw(learned, geometry, PLACE, UP, np.random.default_rng(8).random((60_000, 3), np.float32))
    wi = samples[:, probe.WI : probe.WI + 3]
    expected = cell_integrals(lambda d: probe.hit_pdf(learned, PLACE, UP, d), 32, 32, points=3, subdivisions=8)
    assert expected.sum() == pytest.approx(1.0, abs=0.02)
    assert p_value(histogram(wi, 32, 32), expected / expected.sum(), len(samples)) > sidak(1e-3, 3)
    forward = probe.hit_pdf(learned, PLACE, UP, wi)
    assert (np.abs(forward - samples[:, probe.PDF]) <= 1e-3 * samples[:, probe.PDF]).mean() > 0.998


def test_irradiance_stays_what_it_was() -> None:
    """Lamps, a sun and a sky together, within 4 standard errors of both."""
    sky = np.random.default_rng(9).random((16, 32, 3)).astype(np.float32)
    description = probe.make_description([*_lamps(50), probe.lamp("SUN", angle=0.2)], World("w", "World", None))
    lights, geometry = probe.build(description, background=sky)
    u = np.random.default_rng(10).random((400_000, 3), np.float32)
    values = []
    # The sun is a cluster among many, and must be met often enough to be seen.
    for chosen in (lights, _learned(lights, least=1e-2)):
        samples = probe.draw(chosen, geometry, PLACE, UP, u)
        values.append(probe.irradiance(samples, UP))
    assert values[0].std() < 20.0 * values[0].mean()
    error = np.sqrt(sum(value.var() for value in values) / len(u))
    assert abs(values[0].mean() - values[1].mean()) < 4.0 * error
