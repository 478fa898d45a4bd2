# SPDX-License-Identifier: GPL-3.0-or-later
"""The Shadow Terminator Shading Offset: light that comes in flat is taken away, by every lobe and every technique."""

from __future__ import annotations

import numpy as np
import pytest

from engine.kernels.bsdf.kinds import BUMP
from engine.kernels.bsdf.normals import shift_shading
from tests.helpers.bsdf_harness import (
    BECKMANN,
    DIFFUSE,
    GGX,
    GLASS,
    GLOSSY,
    MULTI_GGX,
    PRINCIPLED,
    TRANSLUCENT,
    Case,
    Lobes,
    at_cosine,
    sobol,
    vector,
)

OFFSETS = (0.3, 1.0)


def shifted(case: Case, offset: float, **options: object) -> Lobes:
    """Lobes as the stage `shift_terminator` leaves them."""
    lobes = Lobes(case, wo=at_cosine(0.6), **options)  # type: ignore[arg-type]
    lobes.closures.param[0, : lobes.closures.count[0], BUMP] += np.float32(0.5 * offset)
    return lobes


def factors(offset: float, cosine: np.ndarray) -> np.ndarray:
    """What Cycles multiplies by (`shift_cos_in`), float64."""
    bent = np.cos(np.arccos(cosine) / (1.0 - 0.5 * offset))
    return np.where(cosine > 0.0, np.maximum(bent, 0.0) / np.abs(cosine), 1.0)


@pytest.mark.parametrize("offset", OFFSETS)
@pytest.mark.parametrize("code", [0, 1, 2])
def test_the_factor_is_the_cosine_of_a_larger_angle_over_the_cosine(offset: float, code: int) -> None:
    cosines = np.linspace(0.01, 1.0, 50, dtype=np.float32)
    bump = np.float32(code + 0.5 * offset)
    found = [shift_shading(bump, cosine) for cosine in cosines]
    np.testing.assert_allclose(found, factors(offset, cosines.astype(np.float64)), atol=2e-5)
    assert shift_shading(bump, np.float32(-0.5)) == 1.0


def test_at_the_full_offset_light_ends_where_it_comes_in_at_45_degrees() -> None:
    assert shift_shading(np.float32(0.5), np.float32(0.70)) == 0.0
    assert shift_shading(np.float32(0.5), np.float32(0.72)) > 0.0


@pytest.mark.parametrize("code", [0.0, 1.0, 2.0])
def test_without_an_offset_nothing_changes(code: float) -> None:
    assert shift_shading(np.float32(code), np.float32(0.1)) == 1.0


@pytest.mark.parametrize("offset", OFFSETS)
@pytest.mark.parametrize("case", [
    Case(DIFFUSE, {"roughness": 0.0}), Case(DIFFUSE, {"roughness": 0.7}), Case(GLOSSY, {"roughness": 0.5}),
    Case(GLOSSY, {"roughness": 0.5}, BECKMANN), Case(GLASS, {"roughness": 0.5}, GGX), Case(TRANSLUCENT),
], ids=str)  # fmt: skip
def test_lobes_that_reflect_have_it_and_what_goes_through_does_not(case: Case, offset: float) -> None:
    directions = np.array([at_cosine(cosine, phi) for cosine in (0.95, 0.5, 0.2, -0.4) for phi in (0.0, 2.0)])
    plain_pdf, plain = Lobes(case, wo=at_cosine(0.6)).evaluate(directions)
    pdf, value = shifted(case, offset).evaluate(directions)
    np.testing.assert_array_equal(pdf, plain_pdf)
    np.testing.assert_allclose(value, plain * factors(offset, directions[:, 2:]), rtol=1e-3, atol=1e-6)


def test_it_goes_by_the_lobes_own_normal() -> None:
    n = vector(0.3, 0.1, 0.95)
    case = Case(DIFFUSE, {"roughness": 0.0}, is_bumped=True)
    directions = np.array([at_cosine(0.4, 0.0), at_cosine(0.4, np.pi)])
    plain = Lobes(case, wo=at_cosine(0.6), n=n).evaluate(directions)[1]
    value = shifted(case, 0.3, n=n).evaluate(directions)[1]
    np.testing.assert_allclose(value, plain * factors(0.3, directions @ np.array(n))[:, None], rtol=1e-3)


@pytest.mark.parametrize("offset", OFFSETS)
@pytest.mark.parametrize("case", [
    Case(DIFFUSE, {"roughness": 0.0}), Case(GLOSSY, {"roughness": 0.6}, MULTI_GGX), Case(GLASS, {"roughness": 0.5}),
    Case(PRINCIPLED, {"coat_weight": 0.5, "sheen_weight": 0.3}),
], ids=str)  # fmt: skip
def test_samples_have_what_evaluation_says(case: Case, offset: float) -> None:
    lobes = shifted(case, offset)
    pdfs, directions, _, values = lobes.sample(sobol(8))
    taken = pdfs > 0.0
    expected = lobes.evaluate(directions[taken])[1]
    np.testing.assert_allclose(values[taken], expected, rtol=1e-4, atol=1e-6)


@pytest.mark.parametrize("offset", OFFSETS)
@pytest.mark.parametrize("case", [Case(GLOSSY, {"roughness": 0.0}), Case(GLASS, {"roughness": 0.0})], ids=str)
def test_mirrors_have_it_and_clear_glass_has_it_in_what_it_reflects(case: Case, offset: float) -> None:
    plain = Lobes(case, wo=at_cosine(0.6)).sample(sobol(6))
    bent = shifted(case, offset).sample(sobol(6))
    np.testing.assert_array_equal(bent[1], plain[1])
    reflects = plain[1][:, 2] > 0.0
    assert reflects.any()
    expected = np.where(reflects[:, None], plain[3] * factors(offset, np.array(0.6)), plain[3])
    np.testing.assert_allclose(bent[3], expected, rtol=1e-4)
