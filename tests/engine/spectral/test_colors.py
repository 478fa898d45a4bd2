# SPDX-License-Identifier: GPL-3.0-or-later
"""Observer and smooth spectra of colours."""

from __future__ import annotations

import itertools

import numpy as np
import numpy.typing as npt
import pytest

from engine.spectral.observer import CIE_1931, D65, GRID, XYZ_TO_REC709, d65, spectrum_to_rec709, xyz_matching
from engine.spectral.precompute import compute_table
from engine.spectral.tables import COEFFICIENTS_FILE
from tests.helpers.color_difference import delta_e_2000, lab_of_rec709
from tests.helpers.spectral_harness import spectra

FloatArray = npt.NDArray[np.float64]


def _cube(count: int) -> FloatArray:
    axis = np.linspace(0.0, 1.0, count)
    return np.stack(np.meshgrid(axis, axis, axis), axis=-1).reshape(-1, 3)


def _round_trip(colors: npt.ArrayLike) -> FloatArray:
    return spectrum_to_rec709(spectra(colors, GRID))


def _difference(colors: npt.ArrayLike) -> FloatArray:
    colors = np.asarray(colors, np.float64)
    return delta_e_2000(lab_of_rec709(colors), lab_of_rec709(_round_trip(colors)))


def test_tables_are_those_of_the_cie() -> None:
    assert CIE_1931.shape == (81, 3) and D65.shape == (81,)
    white = d65(GRID) @ xyz_matching(GRID)
    np.testing.assert_allclose(white[:2] / white.sum(), (0.3127, 0.3290), atol=1e-4)
    # The white of the matrix, of which that of tables of four digits is within 0.1 %.
    np.testing.assert_allclose(white / white[1], np.linalg.inv(XYZ_TO_REC709).sum(axis=1), atol=1e-3)


def test_a_flat_spectrum_is_white() -> None:
    np.testing.assert_allclose(spectrum_to_rec709(np.ones(len(GRID))), 1.0, rtol=1e-12)


def test_equal_energy_is_where_the_cie_says() -> None:
    rgb = spectrum_to_rec709(100.0 / d65(GRID))
    xyz = np.linalg.inv(XYZ_TO_REC709) @ rgb
    np.testing.assert_allclose(xyz[:2] / xyz.sum(), 1.0 / 3.0, atol=5e-4)


def test_colors_come_back() -> None:
    error = _difference(_cube(33))
    assert error.mean() < 0.1
    assert np.quantile(error, 0.99) < 0.25
    assert error.max() < 1.0


def test_random_colors_come_back() -> None:
    random = np.random.default_rng(3)
    for power, mean, worst in ((1.0, 0.1, 1.3), (3.0, 0.1, 1.3), (0.2, 0.1, 1.3)):
        error = _difference(random.random((3000, 3)) ** power)
        assert error.mean() < mean and error.max() < worst


def test_the_corners_of_the_gamut_are_reached() -> None:
    corners = np.array([c for c in itertools.product((0.0, 1.0), repeat=3)])
    np.testing.assert_allclose(_round_trip(corners), corners, atol=1e-4)


def test_reflectances_stay_between_0_and_1() -> None:
    values = spectra(_cube(17), GRID)
    assert values.min() >= 0.0 and values.max() <= 1.0


@pytest.mark.parametrize("value", [0.0, 1e-12, 0.003, 0.18, 0.5, 0.8, 1.0, 1.7, 4e5])
def test_greys_are_constant(value: float) -> None:
    assert set(spectra([(value,) * 3], GRID).ravel()) == {np.float32(value)}


def test_near_greys_are_near_constant() -> None:
    for value in (0.1, 0.5, 0.9):
        values = spectra([(value, value * (1.0 - 1e-6), value)], GRID)
        np.testing.assert_allclose(values, value, rtol=1e-3)


def test_emission_of_any_strength_keeps_its_color() -> None:
    chroma = np.array(((1.0, 0.3, 0.05), (0.2, 1.0, 0.6), (0.7, 0.0, 1.0)))
    for strength in (1e-6, 0.01, 1.0, 1.5, 3.0, 1e4):
        back = _round_trip(strength * chroma) / strength
        assert delta_e_2000(lab_of_rec709(chroma), lab_of_rec709(back)).max() < 0.5


def test_spectra_are_continuous_in_the_color() -> None:
    brighter = ((1.0, 0.2, 0.1), (2.5, 0.5, 0.25))
    from_dark = ((0.1, 0.05, 0.02), (0.9, 0.4, 0.2))
    from_blue_to_red = ((0.1, 0.05, 1.0), (1.0, 0.05, 0.1))
    for start, end in (brighter, from_dark, from_blue_to_red):
        paths = [spectra(np.linspace(start, end, count), GRID[::20]) for count in (1001, 64001)]
        largest = [np.abs(np.diff(path, axis=0)).max() for path in paths]
        # A jump would be as large between points 64 times as close; at 1 spectra change like a square root.
        assert largest[1] < largest[0] / 4.0


def test_broken_colors_give_finite_spectra() -> None:
    nan, inf = float("nan"), float("inf")
    broken = [(nan, 0.2, 0.1), (nan, nan, nan), (inf, 1.0, 0.0), (inf, inf, inf), (-inf, 0.1, 0.2), (1e-39, 0.0, 0.0)]
    values = spectra(broken, (380.0, 550.0, 780.0))
    assert np.isfinite(values).all() and (values >= 0.0).all()


def test_negative_channels_are_taken_for_0() -> None:
    np.testing.assert_array_equal(spectra([(-0.3, 0.5, 0.2)], GRID), spectra([(0.0, 0.5, 0.2)], GRID))
    assert not spectra([(-1.0, -2.0, -0.1)], GRID).any()


def test_the_file_is_what_precompute_makes() -> None:
    with np.load(COEFFICIENTS_FILE) as stored:
        np.testing.assert_allclose(stored["coefficients"], compute_table(), atol=1e-4)
