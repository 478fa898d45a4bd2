# SPDX-License-Identifier: GPL-3.0-or-later
"""Thin walls: what comes through and what is sent back is all that there is, and lies where it should."""

from __future__ import annotations

import numpy as np
import pytest

from engine.kernels.bsdf.thin_wall import inside_share, sheet_shares
from engine.runtime.jit import in_python
from tests.helpers.bsdf_harness import PRINCIPLED, Case, Lobes, at_cosine, sobol

GLASS = {"transmission": 1.0, "thin_wall": 1.0}
LEAF = {"subsurface": 1.0, "thin_wall": 1.0, "specular_level": 0.0}


def _sides(lobes: Lobes) -> tuple[np.ndarray, np.ndarray]:
    """Albedo of what is sent back, and of what comes through."""
    pdfs, directions, _, values = lobes.sample(sobol(14))
    light = np.where(pdfs[:, None] > 0.0, values / np.maximum(pdfs[:, None], 1e-30), 0.0).astype(np.float64)
    is_behind = directions[:, 2] < 0.0
    return light[~is_behind].sum(0) / len(pdfs), light[is_behind].sum(0) / len(pdfs)


@pytest.mark.parametrize("roughness", [0.0, 0.2, 0.6])
@pytest.mark.parametrize("cosine", [1.0, 0.5, 0.2])
def test_white_glass_loses_nothing(roughness: float, cosine: float) -> None:
    back, through = _sides(Lobes(Case(PRINCIPLED, {**GLASS, "roughness": roughness}), wo=at_cosine(cosine)))
    # Tables of what single scattering loses know 0.5% of it.
    np.testing.assert_allclose(back + through, 1.0, atol=5e-3)
    # A sheet of glass sends back what both of its sides do: 2 F / (1 + F) of Fresnel's F.
    f = ((1.0 / 1.5 - 1.0) / (1.0 / 1.5 + 1.0)) ** 2
    if cosine == 1.0 and roughness == 0.0:
        np.testing.assert_allclose(back, 2.0 * f / (1.0 + f), atol=1e-3)


def test_light_inside_a_sheet_is_absorbed_by_the_way_that_it_takes() -> None:
    # Under 60 degrees the way is 1.22 times as long by a refractive index of 1.5: 1 / cos(asin(sin(60) / 1.5)).
    cosine = np.sqrt(1.0 - 0.75 / 2.25)
    inside = in_python(inside_share)(0.3, -cosine)
    assert inside == pytest.approx(0.3 ** (1.0 / cosine))
    assert in_python(inside_share)(0.3, 0.0) == 0.0
    assert in_python(sheet_shares)(0.1, 0.1, inside, False, True) == pytest.approx((0.0, 0.81 * inside))
    assert in_python(sheet_shares)(0.1, 0.2, inside, True, False) == (0.1, 0.0)
    # Between sides that differ: light that has come in is sent to and fro by either.
    r, t = in_python(sheet_shares)(0.1, 0.4, 0.5, True, True)
    assert t == pytest.approx(0.9 * 0.5 * 0.6 / (1.0 - 0.2**2)) and r == pytest.approx(0.1 + t * 0.2)


@pytest.mark.parametrize("diffuse_roughness", [0.0, 0.8])
@pytest.mark.parametrize("anisotropy", [-1.0, 0.0, 0.5, 1.0])
def test_anisotropy_shares_light_between_the_sides_of_a_leaf(diffuse_roughness: float, anisotropy: float) -> None:
    inputs = {**LEAF, "anisotropy": anisotropy, "diffuse_roughness": diffuse_roughness}
    back, through = _sides(Lobes(Case(PRINCIPLED, inputs), wo=at_cosine(0.6)))
    np.testing.assert_allclose(back, 0.5 * (1.0 - anisotropy), atol=5e-3)
    np.testing.assert_allclose(through, 0.5 * (1.0 + anisotropy), atol=5e-3)


@pytest.mark.parametrize(
    "inputs", [{**GLASS, "roughness": 0.5}, {**LEAF, "diffuse_roughness": 0.5, "anisotropy": 0.2}, {**LEAF}]
)
def test_samples_have_the_density_of_their_directions(inputs: dict) -> None:
    lobes = Lobes(Case(PRINCIPLED, inputs), wo=at_cosine(0.7, 0.4))
    pdfs, directions, _, values = lobes.sample(sobol(12))
    valid = pdfs > 0.0
    assert valid.mean() > 0.8
    again, same = lobes.evaluate(directions[valid])
    np.testing.assert_allclose(again, pdfs[valid], rtol=1e-4)
    np.testing.assert_allclose(same, values[valid], rtol=1e-4, atol=1e-6)
    # The density is one: the mean of its inverse over a half of the sphere is how large that is.
    spread = 1.0 / pdfs[valid][directions[valid, 2] < -0.3]
    assert spread.sum() / len(pdfs) == pytest.approx(2.0 * np.pi * 0.7, rel=0.1)


@pytest.mark.parametrize("roughness", [0.0, 0.4])
def test_a_film_changes_colours_and_loses_nothing(roughness: float) -> None:
    """Of 500 nm of soap on a white sheet of glass, straight on."""
    film = {"film_thickness": 500.0, "film_ior": 1.33}
    back, through = _sides(Lobes(Case(PRINCIPLED, {**GLASS, "roughness": roughness, **film}), wo=at_cosine(1.0)))
    bare, _ = _sides(Lobes(Case(PRINCIPLED, {**GLASS, "roughness": roughness}), wo=at_cosine(1.0)))
    np.testing.assert_allclose(back + through, 1.0, atol=6e-3)
    assert back.max() < 1.02 * bare.min() and np.ptp(back) > 0.1 * bare[0]
