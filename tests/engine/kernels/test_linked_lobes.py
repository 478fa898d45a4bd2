# SPDX-License-Identifier: GPL-3.0-or-later
"""Lobes whose kernels are linked: samples against densities, energy, limits, bad input. Seeds are fixed."""

from __future__ import annotations

import numpy as np
import pytest

from engine.kernels.bsdf.conductor import fresnel_conductor
from engine.kernels.bsdf.linked_lobes import ADDED
from engine.kernels.bsdf.tables import load_tables
from engine.kernels.bsdf.thin_film import film_reflectance, film_table
from engine.runtime.jit import kernel
from engine.spectral.observer import GRID, XYZ_TO_REC709, xyz_matching
from engine.state.lanes import RAY_DIFFUSE, RAY_GLOSSY, RAY_SINGULAR, RAY_TRANSMIT
from tests.helpers import chi2
from tests.helpers.bsdf_harness import (
    ASHIKHMIN_SHIRLEY,
    BECKMANN,
    GGX,
    GLASS,
    GLOSSY,
    LINKED,
    PRINCIPLED,
    REFRACTION,
    Case,
    Lobes,
    at_cosine,
    sobol,
)

TOON, VELVET, SHINE = ({"which": ADDED[name]} for name in ("TOON_DIFFUSE", "VELVET", "TOON_GLOSSY"))
COPPER = {"which": ADDED["METAL_BY_INDEX"], "color": (0.27, 0.68, 1.32), "specular_tint": (3.61, 2.63, 2.29)}
FILM = {"film_thickness": 420.0, "film_ior": 1.33}
SIGNIFICANCE = 0.01
SAMPLES = 1 << 16

LOBES = [
    Case(GLOSSY, {"roughness": 0.5}, BECKMANN),
    Case(GLOSSY, {"roughness": 1.0}, BECKMANN),
    Case(GLOSSY, {"roughness": 0.5, "anisotropic": 0.6, "rotation": 0.1}, BECKMANN),
    Case(GLOSSY, {"roughness": 0.5}, ASHIKHMIN_SHIRLEY),
    Case(GLOSSY, {"roughness": 0.6, "anisotropic": 0.5, "rotation": 0.1}, ASHIKHMIN_SHIRLEY),
    Case(REFRACTION, {"roughness": 0.5, "ior": 1.5}, BECKMANN),
    Case(GLASS, {"roughness": 0.5, "ior": 1.5}, BECKMANN, is_backfacing=True),
    Case(GLASS, {"roughness": 0.4, "ior": 1.5, **FILM}),
    Case(GLASS, {"roughness": 0.5, "ior": 1.5, "anisotropic": 0.6, "rotation": 0.1}),
    Case(GLASS, {"roughness": 0.5, "ior": 1.5, "anisotropic": -0.5}, BECKMANN, is_backfacing=True),
    Case(PRINCIPLED, {"transmission": 0.7, "roughness": 0.5, "anisotropic": 0.8, "stretches_glass": 1.0}),
    Case(PRINCIPLED, {"metallic": 0.5, "roughness": 0.4, **FILM}),
    Case(LINKED, {"roughness": 0.5, "anisotropic": 0.7, **COPPER}),
    Case(LINKED, {"first": 1.0, **TOON}),
    Case(LINKED, {"first": 0.6, **VELVET}),
]
COSINES = (0.95, 0.15)


@pytest.mark.parametrize("case", LOBES, ids=str)
@pytest.mark.parametrize("cosine", COSINES)
def test_samples_follow_the_density(case: Case, cosine: float) -> None:
    lobes = Lobes(case, wo=at_cosine(cosine, 0.4))
    u = np.random.default_rng(7).random((SAMPLES, 3), dtype=np.float32)
    pdfs, directions, _labels, values = lobes.sample(u)
    kept = pdfs > 0.0
    observed = chi2.histogram(directions[kept], 24, 48)
    probability = chi2.cell_integrals(lambda wi: lobes.evaluate(wi)[0], 24, 48, points=4, subdivisions=8)
    assert probability.sum() <= 1.0 + 2e-3
    limit = chi2.sidak(SIGNIFICANCE, len(LOBES) * len(COSINES))
    assert chi2.p_value(observed, probability, SAMPLES) > limit
    again, same = lobes.evaluate(directions[kept])
    np.testing.assert_allclose(again, pdfs[kept], rtol=1e-6)
    np.testing.assert_allclose(same, values[kept], rtol=1e-6)


_ORANGE = {"color": (0.8, 0.4, 0.1), "roughness": 0.5, "ior": 1.5, "rotation": 0.1}
#: What Cycles 5.3 gives by light samples: f cos in red, at cosines of the viewer of 0.8 and 1.
STRETCHED = [
    (Case(GLASS, {**_ORANGE, "anisotropic": 0.6}, GGX), (0.0011439, 3.5798)),
    (Case(GLASS, {**_ORANGE, "anisotropic": 0.6}, BECKMANN), (3.5819e-05, 3.495)),
    (Case(GLASS, {**_ORANGE, "anisotropic": 0.6}, GGX, is_backfacing=True), (0.0011606, 3.4715)),
    (
        Case(PRINCIPLED, {**_ORANGE, "transmission": 1.0, "anisotropic": 0.8, "stretches_glass": 1.0}, GGX),
        (0.00034824, 0.062287),
    ),
]


@pytest.mark.parametrize(("case", "values"), STRETCHED, ids=str)
def test_anisotropic_glass_reflects_and_refracts_as_in_cycles(case: Case, values: tuple[float, float]) -> None:
    for cosine, sun, expected in zip((0.8, 1.0), ((0.3, 0.5, 0.9), (0.1, -0.2, -1.0)), values, strict=True):
        sine = np.sqrt(1.0 - cosine**2)
        x, y, z = np.array(sun) / np.linalg.norm(sun)
        wi = np.array([[x * cosine - z * sine, y, x * sine + z * cosine]])
        value = Lobes(case, wo=at_cosine(cosine, np.pi)).evaluate(wi)[1][0, 0]
        np.testing.assert_allclose(value, expected, rtol=2e-4)


@pytest.mark.parametrize("which", [TOON, SHINE])
def test_toon_is_even_within_its_cone(which: dict) -> None:
    wo = at_cosine(0.9)
    lobes = Lobes(Case(LINKED, {"first": 0.5, "second": 0.0, **which}), wo=wo)
    pdfs, directions, _, _ = lobes.sample(sobol(10))
    axis = np.array([0.0, 0.0, 1.0]) if which is TOON else np.array([-wo[0], 0.0, wo[2]])
    angles = np.arccos(directions[pdfs > 0.0] @ axis)
    assert angles.max() < 0.25 * np.pi + 1e-3
    np.testing.assert_allclose(pdfs[pdfs > 0.0], 1.0 / (2.0 * np.pi * (1.0 - np.cos(0.25 * np.pi))), rtol=1e-5)


def test_the_least_toon_cone_loses_no_light() -> None:
    """Of 1e-5 of a right angle: cosines there are 1 but for their last bits, which lost most of the light."""
    for cosine in (0.9, 0.5):
        albedo = Lobes(Case(LINKED, {"first": 0.0, "second": 0.0, **SHINE}), wo=at_cosine(cosine, 0.4)).albedo(12)
        np.testing.assert_allclose(albedo, 1.0, atol=0.02)


@pytest.mark.parametrize("roughness", [0.0, 0.3])
@pytest.mark.parametrize("is_backfacing", [False, True])
def test_a_film_on_clear_glass_takes_no_light(roughness: float, is_backfacing: bool) -> None:
    inputs = {"roughness": roughness, "ior": 1.5, **FILM}
    for cosine in (1.0, 0.5):
        albedo = Lobes(Case(GLASS, inputs, is_backfacing=is_backfacing), wo=at_cosine(cosine)).albedo(14)
        np.testing.assert_allclose(albedo, 1.0, atol=6e-3)


@kernel
def _film(block, wavelength, cosine, thickness, film_ior, n, k, out):
    for c in range(3):
        out[c] = film_reflectance(block, c, wavelength, cosine, thickness, film_ior, n, k, np.float32(-1.0))


def _reflectance(
    cosine: float, thickness: float, ior: float, n: float, k: float, wavelength: float = 0.0
) -> np.ndarray:
    out = np.zeros(3, np.float32)
    numbers = (np.float32(x) for x in (wavelength, cosine, thickness, ior, n, k))
    _film(load_tables().linked.ctypes.data, *numbers, out)
    return out


def _exact(cosine: float, thickness: float, ior: float, substrate: complex, wavelengths: np.ndarray) -> np.ndarray:
    """Airy's formula with complex amplitudes (Born and Wolf, section 1.6.4)."""
    sine = np.sqrt(1.0 - cosine**2)
    cosines = [np.sqrt(1.0 - (sine / index) ** 2 + 0j) for index in (1.0, ior, substrate)]
    delta = 2.0 * np.pi / wavelengths * 2.0 * ior * thickness * cosines[1]
    total = np.zeros(len(wavelengths))
    for is_p in (False, True):
        amplitudes = []
        for side in (0, 1):
            a, b = (1.0, ior, substrate)[side : side + 2]
            cos_a, cos_b = cosines[side : side + 2]
            x, y = (b * cos_a, a * cos_b) if is_p else (a * cos_a, b * cos_b)
            amplitudes.append((x - y) / (x + y))
        r12, r23 = amplitudes
        whole = (r12 + r23 * np.exp(1j * delta)) / (1.0 + r12 * r23 * np.exp(1j * delta))
        total += 0.5 * np.abs(whole) ** 2
    return total


@pytest.mark.parametrize("cosine", [1.0, 0.6, 0.2])
@pytest.mark.parametrize("thickness", [100.0, 420.0, 1500.0])
@pytest.mark.parametrize(("ior", "substrate"), [(1.33, 1.5 + 0j), (2.0, 1.5 + 0j), (1.5, 0.27 + 3.61j)])
def test_a_film_reflects_as_its_amplitudes_do(cosine: float, thickness: float, ior: float, substrate: complex) -> None:
    wavelengths = GRID[::40]
    k = substrate.imag if substrate.imag > 0.0 else -1.0
    exact = _exact(cosine, thickness, ior, substrate, GRID)
    ours = [_reflectance(cosine, thickness, ior, substrate.real, k, wavelength)[0] for wavelength in wavelengths]
    np.testing.assert_allclose(ours, exact[::40], atol=2e-4)
    # A colour is the mean over its responses; the series stops at the third crossing, which is early where both sides
    # reflect much.
    tolerance = 0.04 if k > 0.0 and cosine < 0.5 else 0.012
    responses = xyz_matching(GRID) @ XYZ_TO_REC709.T.astype(np.float64)
    expected = exact @ responses / responses.sum(axis=0)
    np.testing.assert_allclose(_reflectance(cosine, thickness, ior, substrate.real, k), expected, atol=tolerance)


def test_films_of_a_working_space_are_those_of_its_primaries() -> None:
    turned = np.linalg.inv(XYZ_TO_REC709.astype(np.float64)).astype(np.float32)
    np.testing.assert_allclose(film_table(turned), film_table(None), atol=1e-5)
    np.testing.assert_allclose(film_table(None)[:, 0], (1, 1, 1, 0, 0, 0), atol=1e-6)


def test_a_thin_film_fades_out() -> None:
    plain = Lobes(Case(PRINCIPLED, {"color": (0.5, 0.5, 0.5)}), wo=at_cosine(0.8)).albedo(12)
    thin = Lobes(
        Case(PRINCIPLED, {"color": (0.5, 0.5, 0.5), "film_thickness": 0.11, "film_ior": 2.0}), wo=at_cosine(0.8)
    )
    np.testing.assert_allclose(thin.albedo(12), plain, atol=6e-3)


@kernel
def _conductor(cosine, n, k, out):
    out[0] = fresnel_conductor(cosine, n, k)


def test_metals_reflect_as_textbooks_say() -> None:
    out = np.zeros(1, np.float32)
    for cosine in (1.0, 0.5, 0.05):
        for index in (0.27 + 3.61j, 2.7 + 3.9j):
            cos_t = np.sqrt(1.0 - (1.0 - cosine**2) / index**2)
            r_s = (cosine - index * cos_t) / (cosine + index * cos_t)
            r_p = (index * cosine - cos_t) / (index * cosine + cos_t)
            _conductor(np.float32(cosine), np.float32(index.real), np.float32(index.imag), out)
            assert out[0] == pytest.approx(0.5 * (abs(r_s) ** 2 + abs(r_p) ** 2), abs=1e-5)


@pytest.mark.parametrize(
    ("case", "label"),
    [
        (Case(GLOSSY, {"roughness": 0.0}, ASHIKHMIN_SHIRLEY), RAY_GLOSSY | RAY_SINGULAR),
        (Case(LINKED, {"roughness": 0.0, **COPPER}), RAY_GLOSSY | RAY_SINGULAR),
        (Case(LINKED, {**VELVET}), RAY_DIFFUSE),
        (Case(LINKED, {**TOON}), RAY_DIFFUSE),
        (Case(LINKED, {**SHINE}), RAY_GLOSSY),
    ],
    ids=str,
)
def test_labels_say_what_happened(case: Case, label: int) -> None:
    pdfs, _, labels, _ = Lobes(case, wo=at_cosine(0.7)).sample(sobol(8))
    assert (labels[pdfs > 0.0] & (RAY_DIFFUSE | RAY_GLOSSY | RAY_SINGULAR | RAY_TRANSMIT) == label).all()


BAD = (np.nan, np.inf, -np.inf, -1.0, 0.0, 1.0, 1e9, 1e38, 1e-38)


@pytest.mark.parametrize("distribution", [GGX, BECKMANN, ASHIKHMIN_SHIRLEY])
def test_bad_input_gives_numbers(distribution: int) -> None:
    names = ("roughness", "ior", "film_thickness", "film_ior", "anisotropic", "rotation", "first", "second")
    nodes = [(GLOSSY, {}), (GLASS, FILM), (PRINCIPLED, FILM), (LINKED, TOON), (LINKED, VELVET), (LINKED, SHINE)]
    nodes += [(LINKED, {**COPPER, **FILM}), (LINKED, {**FILM, "which": ADDED["METAL"]})]
    directions = np.array([at_cosine(0.5, 1.0), at_cosine(-0.5, 2.0), at_cosine(0.01)])
    for node, inputs in nodes:
        for name in names:
            for bad in BAD:
                lobes = Lobes(Case(node, {**inputs, name: bad}, distribution), wo=at_cosine(0.6))
                pdfs, wi, _, values = lobes.sample(sobol(3))
                found = (pdfs, wi, values, *lobes.evaluate(directions))
                assert all(np.isfinite(x).all() for x in found), (node, name, bad)
                assert all((x >= 0.0).all() for x in (pdfs, values))


@pytest.mark.parametrize("bad", BAD)
def test_bad_refractive_indices_of_metals_give_numbers(bad: float) -> None:
    for name in ("color", "specular_tint"):
        for film in ({}, FILM):
            lobes = Lobes(Case(LINKED, {"roughness": 0.3, **COPPER, **film, name: (bad, 1.0, bad)}), wo=at_cosine(0.6))
            albedo = lobes.albedo(6)
            assert np.isfinite(albedo).all() and (albedo >= 0.0).all() and (albedo < 1.1).all()
