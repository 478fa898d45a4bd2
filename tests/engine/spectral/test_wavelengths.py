# SPDX-License-Identifier: GPL-3.0-or-later
"""Wavelengths of paths, blackbodies and refraction by wavelength."""

from __future__ import annotations

import math

import numpy as np
import pytest

from engine.spectral.dispersion import LINE_C, LINE_D, LINE_F, dispersion_from_abbe, dispersion_from_cauchy
from engine.spectral.observer import GRID, d65, spectrum_to_rec709, xyz_matching
from engine.spectral.wavelengths import CELL_COUNT, WAVELENGTH_COUNT, wavelength_density
from tests.helpers.spectral_harness import blackbodies, iors, spectra, wavelengths_and_weights

#: Many to a cell of the tables, which are straight between the ends of a cell.
NUMBERS = (np.arange(CELL_COUNT * 64) + 0.5) / (CELL_COUNT * 64)
LUMINANCE = (0.2126390, 0.7151687, 0.0721923)


def test_weights_of_white_have_mean_1() -> None:
    drawn = wavelengths_and_weights(NUMBERS).astype(np.float64)
    np.testing.assert_allclose(drawn[:, 1:].mean(axis=0), 1.0, atol=2e-6)


def test_weights_integrate_any_spectrum() -> None:
    drawn = wavelengths_and_weights(NUMBERS).astype(np.float64)
    for spectrum in (
        np.exp((GRID - 560.0) / 100.0),
        np.exp(-0.5 * ((GRID - 480.0) / 15.0) ** 2),
        blackbodies([1000.0], GRID)[0],
        spectra([(0.9, 0.2, 0.0)], GRID)[0],
        (GRID > 600.0).astype(float),
    ):
        expected = spectrum_to_rec709(spectrum)
        found = (drawn[:, 1:] * np.interp(drawn[:, 0], GRID, spectrum)[:, None]).mean(axis=0)
        np.testing.assert_allclose(found, expected, atol=1e-3 * np.abs(expected).max())


def test_wavelengths_have_their_density() -> None:
    drawn = wavelengths_and_weights(NUMBERS)[:, 0]
    edges = np.linspace(380.0, 780.0, 41)
    fine = np.linspace(380.0, 780.0, 4001)
    cumulated = np.concatenate([[0.0], np.cumsum(wavelength_density(0.5 * (fine[1:] + fine[:-1])) * 0.1)])
    expected = np.diff(np.interp(edges, fine, cumulated))
    found = np.histogram(drawn, edges)[0] / len(drawn)
    assert abs(cumulated[-1] - 1.0) < 1e-5
    np.testing.assert_allclose(found, expected, atol=1e-3)


def test_the_four_wavelengths_of_a_path_divide_the_range_evenly() -> None:
    numbers = (np.arange(4096) + 0.5) / 4096
    per_wavelength = [wavelengths_and_weights(numbers, index) for index in range(WAVELENGTH_COUNT)]
    everyone = np.sort(per_wavelength[0][:, 0])
    for drawn in per_wavelength:
        np.testing.assert_allclose(np.sort(drawn[:, 0]), everyone, atol=1e-2)
    # The mean of four is far less noisy than one: that is what the density was chosen for.
    one = per_wavelength[0][:, 1:].var(axis=0).mean()
    four = np.mean(per_wavelength, axis=0)[:, 1:].var(axis=0).mean()
    assert one < 3.5 and four < 0.016


def test_numbers_at_the_ends_and_beyond() -> None:
    drawn = wavelengths_and_weights([0.0, 1.0, 1.0 - 2.0**-24, -1.0, 2.0, math.nan, math.inf, -math.inf])
    assert np.isfinite(drawn).all()
    np.testing.assert_array_equal(drawn[:2, 0], (380.0, 780.0))
    assert drawn[:, 0].min() == 380.0 and drawn[:, 0].max() == 780.0
    moved = wavelengths_and_weights([0.0, 0.25, 0.75, 1.0 - 2.0**-24], 3)[:, 0]
    assert moved[1] == 380.0 and ((moved >= 380.0) & (moved <= 780.0)).all()


@pytest.mark.parametrize(
    ("temperature", "chromaticity"),
    [
        (2856.0, (0.4476, 0.4074)),  # CIE illuminant A
        (1000.0, (0.6528, 0.3444)),
        (6500.0, (0.3135, 0.3237)),
        (10000.0, (0.2807, 0.2884)),
    ],
)
def test_blackbodies_have_their_color(temperature: float, chromaticity: tuple[float, float]) -> None:
    xyz = (d65(GRID) * blackbodies([temperature], GRID)[0]) @ xyz_matching(GRID)
    np.testing.assert_allclose(xyz[:2] / xyz.sum(), chromaticity, atol=2e-4)


def test_blackbodies_have_luminance_1() -> None:
    temperatures = np.concatenate([np.geomspace(500.0, 1e6, 200), [0.0, -3.0, math.nan, math.inf]])
    values = blackbodies(temperatures, GRID)
    assert np.isfinite(values).all() and (values > 0.0).all()
    # 0.1 %: the Y of D65 by tables of four digits.
    np.testing.assert_allclose(spectrum_to_rec709(values) @ LUMINANCE, 1.0, atol=1e-3)


def test_white_of_a_blackbody_is_near_that_of_d65() -> None:
    rgb = spectrum_to_rec709(blackbodies([6504.0], GRID))[0]
    np.testing.assert_allclose(rgb, 1.0, atol=0.07)
    assert rgb[1] < 1.0, "the locus of blackbodies lies below D65"


@pytest.mark.parametrize(("ior", "abbe_number"), [(1.5168, 64.17), (1.7847, 26.08), (1.333, 55.7), (2.417, 55.0)])
def test_abbe_numbers_come_back(ior: float, abbe_number: float) -> None:
    n_f, n_d, n_c = iors(ior, dispersion_from_abbe(abbe_number), (LINE_F, LINE_D, LINE_C)).astype(np.float64)
    assert n_d == pytest.approx(ior, abs=2e-7)
    assert (n_d - 1.0) / (n_f - n_c) == pytest.approx(abbe_number, rel=1e-4)


def test_cauchy_coefficients_come_back() -> None:
    a, b = 1.5046, 0.0042  # BK7
    at_d = a + b / (1e-3 * LINE_D) ** 2
    found = iors(at_d, dispersion_from_cauchy(a, b), GRID)
    np.testing.assert_allclose(found, a + b / (1e-3 * GRID) ** 2, rtol=1e-6)


def test_no_dispersion_is_exactly_the_index() -> None:
    assert set(iors(1.45, 0.0, GRID)) == {np.float32(1.45)}
    for nothing in (
        dispersion_from_abbe(0.0),
        dispersion_from_abbe(-5.0),
        dispersion_from_abbe(math.nan),
        dispersion_from_abbe(math.inf),
        dispersion_from_cauchy(1.0, 0.0),
        dispersion_from_cauchy(math.nan, 0.01),
        dispersion_from_cauchy(1.5, math.inf),
        dispersion_from_cauchy(1.5, 0.0),
    ):
        assert nothing == 0.0


def test_indices_stay_positive() -> None:
    for ior, dispersion in ((0.2, 5.0), (1.5, -9.0), (1.5, 1e30), (1.5, math.nan), (3.0, math.inf)):
        found = iors(ior, dispersion, (380.0, 500.0, LINE_D, 780.0))
        assert (found > 9e-4).all()


def test_the_blue_end_is_bent_most() -> None:
    found = iors(1.5, dispersion_from_abbe(30.0), GRID)
    assert (np.diff(found) < 0.0).all()
