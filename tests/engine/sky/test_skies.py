# SPDX-License-Identifier: GPL-3.0-or-later
"""Skies by what is known of them; benchmarks/scenes/skies.py has their pictures beside Cycles'."""

from __future__ import annotations

import math
from dataclasses import replace
from types import ModuleType

import numpy as np
import pytest

from engine.sky import multiple_scattering, single_scattering
from engine.sky.daylight import hosek_wilkie, preetham
from engine.sky.sky_maps import MAP_HEIGHT, MAP_WIDTH, Atmosphere, horizon_angle, row_elevations

NOON = Atmosphere(1.0, 100.0, 1.0, 1.0, 1.0)
MODELS = (multiple_scattering, single_scattering)


@pytest.mark.parametrize("model", MODELS)
def test_a_map_is_the_same_on_both_sides_of_the_sun_and_brightest_there(model: ModuleType) -> None:
    sky = model.sky_map(NOON)
    assert sky.shape == (MAP_HEIGHT, MAP_WIDTH, 3) and sky.dtype == np.float32
    np.testing.assert_array_equal(sky, sky[:, ::-1])
    # The haze above the horizon aside.
    is_high = row_elevations() > 0.6
    row, column = np.unravel_index(np.argmax(sky[is_high, :, 1]), (is_high.sum(), MAP_WIDTH))
    assert abs(row_elevations()[is_high][row] - 1.0) < 0.05 and abs(column - MAP_WIDTH / 2) <= 1
    # It is blue overhead: in XYZ more Z than X.
    assert sky[-1, 0, 2] > 1.3 * sky[-1, 0, 0]


@pytest.mark.parametrize("model", MODELS)
def test_the_sun_gives_what_the_air_leaves_of_it(model: ModuleType) -> None:
    """Without air all of it, redder and less the lower it stands; small or large, its irradiance is the same."""
    free = replace(NOON, air_density=0.0, aerosol_density=0.0, ozone_density=0.0)
    low = replace(NOON, sun_elevation=0.1)
    of_free, of_noon, of_low = (model.sun_ends(sky, 0.01).mean(axis=0) for sky in (free, NOON, low))
    assert (of_free > of_noon).all() and (of_noon > of_low).all()
    assert of_low[2] / of_low[0] < of_noon[2] / of_noon[0]
    larger = model.sun_ends(free, 0.02).mean(axis=0)
    np.testing.assert_allclose(larger, 0.25 * of_free, rtol=1e-3)


@pytest.mark.parametrize("model", MODELS)
def test_extremes_are_finite_and_nothing_shines_without_air(model: ModuleType) -> None:
    for changes in (
        {"sun_elevation": -0.5 * math.pi, "altitude": 0.0}, {"sun_elevation": 0.5 * math.pi, "altitude": 1e5},
        {"air_density": 1000.0, "aerosol_density": 1000.0, "ozone_density": 1000.0},
    ):  # fmt: skip
        sky = model.sky_map(replace(NOON, **changes))
        assert np.isfinite(sky).all() and (sky >= -1e-3).all()
    assert not model.sky_map(replace(NOON, air_density=0.0, aerosol_density=0.0)).any()


def test_after_sunset_the_sky_is_dark_and_single_scattering_has_no_sun() -> None:
    night = replace(NOON, sun_elevation=-0.3)
    assert multiple_scattering.sky_map(night).mean() < 1e-3 * multiple_scattering.sky_map(NOON).mean()
    assert not single_scattering.sun_ends(night, 0.01).any()
    assert horizon_angle(0.0) == 0.0 and 0.05 < horizon_angle(10_000.0) < 0.06


def test_preethams_zenith_is_the_one_of_the_paper() -> None:
    """A sun at 60 degrees from the zenith, turbidity 3: its luminance by Eq. (A.2), and the formula's value there."""
    sky = preetham((0.0, math.sin(math.radians(60.0)), 0.5), 3.0)
    chi = (4.0 / 9.0 - 3.0 / 120.0) * (math.pi - 2.0 * math.radians(60.0))
    zenith = (4.0453 * 3.0 - 4.9710) * math.tan(chi) - 0.2155 * 3.0 + 2.4192
    c = sky.coefficients[0]
    gamma = math.radians(60.0)
    value = (1.0 + c[0] * math.exp(c[1])) * (c[2] + c[3] * math.exp(c[4] * gamma) + c[5] * math.cos(gamma) ** 2)
    assert sky.radiance[0] * value == pytest.approx(0.06 * zenith, rel=1e-6)


def test_hosek_wilkie_goes_between_the_turbidities_of_its_fit() -> None:
    half = hosek_wilkie((0.0, 0.6, 0.8), 3.5, 0.25)
    ends = [hosek_wilkie((0.0, 0.6, 0.8), turbidity, 0.25) for turbidity in (3.0, 4.0)]
    np.testing.assert_allclose(half.coefficients, 0.5 * (ends[0].coefficients + ends[1].coefficients), rtol=1e-9)
    np.testing.assert_allclose(half.radiance, 0.5 * (ends[0].radiance + ends[1].radiance), rtol=1e-9)
    # Beyond the fit: its last turbidity, and the sun on the horizon.
    last = hosek_wilkie((0.0, 0.6, 0.8), 10.0, 1.0)
    np.testing.assert_array_equal(last.coefficients, hosek_wilkie((0.0, 0.6, 0.8), 99.0, 1.0).coefficients)
    assert hosek_wilkie((0.0, 1.0, -0.1), 3.0, 0.0).theta == pytest.approx(0.5 * math.pi)
