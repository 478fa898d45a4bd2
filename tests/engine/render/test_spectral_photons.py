# SPDX-License-Identifier: GPL-3.0-or-later
"""Caustics at wavelengths: the same light and the same spectrum as paths find, and less noise."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from engine.kernels.photon_windows import power_of_channel
from engine.spectral.wavelengths import rotate_hero
from engine.state.photons import PHOTON_HERO, PHOTON_POWERS, PHOTON_WIDTH_MORE
from tests.helpers.caustic_scenes import prism_scene
from tests.helpers.photon_renders import assert_same_light, pictures

pytestmark = pytest.mark.estimator
#: Kernels of wavelengths are kernels of their own, which take half a minute to compile.
with_wavelengths = pytest.mark.slow


def test_a_photon_brings_its_power_to_the_wavelengths_that_are_near() -> None:
    numbers, half = np.random.default_rng(1), np.float32(0.03)
    photons = np.zeros((1, PHOTON_WIDTH_MORE), np.float32)
    photons[0, PHOTON_POWERS : PHOTON_POWERS + 4] = 1.0, 10.0, 100.0, 1000.0
    for hero, of_photon in numbers.uniform(size=(2000, 2)).astype(np.float32):
        photons[0, PHOTON_HERO] = of_photon
        for c in range(4):
            x, expected = rotate_hero(hero, c), 0.0
            for k in range(4):
                y = rotate_hero(of_photon, k)
                near = sum([abs(x - y) < half, x + y < half, 2.0 - x - y < half])
                expected += near * photons[0, PHOTON_POWERS + k]
            assert power_of_channel(photons, 0, hero, c, half) == pytest.approx(expected)


@with_wavelengths
def test_glass_that_does_not_disperse_is_as_bright_as_by_paths() -> None:
    """All of a photon's wavelengths arrive."""
    scene = prism_scene(2.0, 0.0)
    assert_same_light(*(pictures(scene, caustics, spectral="ON") for caustics in ("PHOTONS", "PATHS")), 0.02)


@with_wavelengths
def test_a_prism_has_the_spectrum_that_it_has_by_paths() -> None:
    """Colours lie beside each other along the columns."""
    by_photons, by_paths = (
        pictures(prism_scene(2.0), caustics, samples=1024, spectral="ON") for caustics in ("PHOTONS", "PATHS")
    )
    assert_same_light(by_photons, by_paths, 0.02)


@with_wavelengths
def test_photons_make_less_noise_where_the_lamp_is_small() -> None:
    by_photons, by_paths = (
        pictures(prism_scene(0.1), caustics, range(2), samples=64, spectral="ON") for caustics in ("PHOTONS", "PATHS")
    )
    assert 4.0 * by_photons.var(axis=0).mean() < by_paths.var(axis=0).mean()


@with_wavelengths
@pytest.mark.parametrize("roughness", [0.1, 0.5])
def test_rough_glass_that_disperses_is_left_to_paths(roughness: float) -> None:
    scene = prism_scene(2.0)
    glass = scene.materials[1]
    glass.graph.nodes[0].inputs["Roughness"] = roughness
    by_photons, by_paths = (
        pictures(replace(scene), caustics, [1], samples=4, spectral="ON") for caustics in ("PHOTONS", "PATHS")
    )
    np.testing.assert_allclose(by_photons, by_paths, rtol=1e-5, atol=1e-6)
