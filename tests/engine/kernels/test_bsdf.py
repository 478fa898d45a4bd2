# SPDX-License-Identifier: GPL-3.0-or-later
"""Closures: samples against densities, energy, reciprocity, limits. Seeds are fixed."""

from __future__ import annotations

import numpy as np
import pytest

from engine.kernels.bsdf import HAS_DELTA, HAS_EVAL, HAS_TRANSMISSION, HAS_TRANSPARENT
from engine.state.lanes import RAY_DIFFUSE, RAY_GLOSSY, RAY_REFLECT, RAY_SINGULAR, RAY_TRANSMIT, RAY_TRANSPARENT
from tests.helpers import chi2
from tests.helpers.bsdf_harness import (
    DIFFUSE,
    GGX,
    GLASS,
    GLOSSY,
    PRINCIPLED,
    REFRACTION,
    TRANSLUCENT,
    TRANSPARENT,
    UP,
    Case,
    Lobes,
    at_cosine,
    sobol,
    vector,
)

DELTA = RAY_SINGULAR | RAY_TRANSPARENT
#: Probability that a correct build fails the family of chi-square tests for some other seed.
SIGNIFICANCE = 0.01
CHI2_SAMPLES = 1 << 17
COSINES = (0.95, 0.6, 0.15)

LOBES = [
    (Case(DIFFUSE),),
    (Case(DIFFUSE, {"roughness": 0.8}),),
    (Case(TRANSLUCENT),),
    (Case(GLOSSY, {"roughness": 0.25}),),
    (Case(GLOSSY, {"roughness": 0.5}),),
    (Case(GLOSSY, {"roughness": 1.0}),),
    (Case(GLOSSY, {"roughness": 0.5, "anisotropic": 0.6, "rotation": 0.1}),),
    (Case(REFRACTION, {"roughness": 0.5, "ior": 1.5}),),
    (Case(REFRACTION, {"roughness": 0.7, "ior": 1.5}, is_backfacing=True),),
    (Case(GLASS, {"roughness": 0.3, "ior": 1.5}),),
    (Case(GLASS, {"roughness": 0.8, "ior": 1.2, "color": (0.9, 0.5, 0.2)}),),
    (Case(GLASS, {"roughness": 0.5, "ior": 1.5}, is_backfacing=True),),
    (Case(GLASS, {"roughness": 0.9, "ior": 2.0}, is_backfacing=True),),
    (Case(PRINCIPLED, {"color": (0.8, 0.4, 0.1)}),),
    (Case(PRINCIPLED, {"metallic": 0.5, "roughness": 0.4, "coat_weight": 0.5, "coat_roughness": 0.3, "alpha": 0.8}),),
    (Case(PRINCIPLED, {"transmission": 0.5, "sheen_weight": 1.0, "coat_weight": 1.0, "coat_roughness": 0.0}),),
    (Case(PRINCIPLED, {"sheen_weight": 1.0, "sheen_roughness": 0.3, "color": (0.0, 0.0, 0.0)}),),
    (Case(DIFFUSE), Case(TRANSPARENT), Case(GLASS, {"roughness": 0.0}), Case(GLASS, {"roughness": 0.6})),
]
FAMILY = len(LOBES) * len(COSINES)


def name_of(cases: tuple[Case, ...]) -> str:
    return "+".join(map(str, cases))


@pytest.mark.parametrize("cases", LOBES, ids=name_of)
@pytest.mark.parametrize("cosine", COSINES)
def test_samples_follow_the_density(cases: tuple[Case, ...], cosine: float) -> None:
    lobes = Lobes(*cases, wo=at_cosine(cosine, 0.4))
    u = np.random.default_rng(7).random((CHI2_SAMPLES, 3), dtype=np.float32)
    pdfs, directions, labels, _values = lobes.sample(u)
    kept = (pdfs > 0.0) & (labels & DELTA == 0)
    observed = chi2.histogram(directions[kept], 24, 48)
    probability = chi2.cell_integrals(lambda wi: lobes.evaluate(wi)[0], 24, 48, points=4, subdivisions=8)
    assert probability.sum() <= 1.0 + 2e-3
    assert chi2.p_value(observed, probability, CHI2_SAMPLES) > chi2.sidak(SIGNIFICANCE, FAMILY)


@pytest.mark.parametrize("cases", LOBES, ids=name_of)
def test_sample_returns_what_eval_says(cases: tuple[Case, ...]) -> None:
    lobes = Lobes(*cases, wo=at_cosine(0.5, 1.0))
    pdfs, directions, labels, values = lobes.sample(sobol(10))
    kept = (pdfs > 0.0) & (labels & DELTA == 0)
    again_pdfs, again_values = lobes.evaluate(directions[kept])
    assert kept.sum() > 100
    np.testing.assert_allclose(again_pdfs, pdfs[kept], rtol=1e-6)
    np.testing.assert_allclose(again_values, values[kept], rtol=1e-6)
    assert np.isfinite(values[kept]).all() and (values[kept] >= 0.0).all()


@pytest.mark.parametrize(
    ("case", "label"),
    [
        (Case(DIFFUSE), RAY_DIFFUSE | RAY_REFLECT),
        (Case(TRANSLUCENT), RAY_DIFFUSE | RAY_TRANSMIT),
        (Case(GLOSSY, {"roughness": 0.5}), RAY_GLOSSY | RAY_REFLECT),
        (Case(GLOSSY, {"roughness": 0.0}), RAY_GLOSSY | RAY_REFLECT | RAY_SINGULAR),
        (Case(REFRACTION, {"roughness": 0.0}), RAY_GLOSSY | RAY_TRANSMIT | RAY_SINGULAR),
        (Case(TRANSPARENT), RAY_TRANSPARENT | RAY_TRANSMIT),
    ],
    ids=str,
)
def test_labels_say_what_happened(case: Case, label: int) -> None:
    pdfs, _directions, labels, _values = Lobes(case, wo=at_cosine(0.7)).sample(sobol(6))
    assert set(labels[pdfs > 0.0]) == {label}


def test_smooth_glass_obeys_snell_and_fresnel() -> None:
    wo = at_cosine(0.5)
    pdfs, directions, labels, values = Lobes(Case(GLASS, {"roughness": 0.0, "ior": 1.5}), wo=wo).sample(sobol(12))
    refracted = labels & RAY_TRANSMIT != 0
    sine_t = np.sqrt(0.75) / 1.5
    down = (-sine_t, 0.0, -np.sqrt(1.0 - sine_t**2))
    np.testing.assert_allclose(directions[refracted], [down] * refracted.sum(), atol=1e-6)
    np.testing.assert_allclose(directions[~refracted], [[-wo[0], 0.0, wo[2]]] * (~refracted).sum(), atol=1e-6)
    cos_t = np.sqrt(1.0 - sine_t**2)
    r_s, r_p = (0.5 - 1.5 * cos_t) / (0.5 + 1.5 * cos_t), (0.75 - cos_t) / (0.75 + cos_t)
    reflectance = 0.5 * (r_s**2 + r_p**2)
    np.testing.assert_allclose(pdfs[~refracted], reflectance, rtol=1e-5)
    np.testing.assert_allclose(values[:, 0] / pdfs, 1.0, rtol=1e-5)
    assert labels[0] & RAY_SINGULAR and not Lobes(Case(GLASS, {"roughness": 0.0}), wo=wo).evaluate(directions)[0].any()


def test_total_internal_reflection() -> None:
    case = Case(GLASS, {"roughness": 0.0, "ior": 1.5}, is_backfacing=True)
    pdfs, _directions, labels, values = Lobes(case, wo=at_cosine(0.5)).sample(sobol(6))
    assert (labels & RAY_REFLECT != 0).all()
    np.testing.assert_allclose(values[:, 1] / pdfs, 1.0, rtol=1e-5)
    none = Lobes(Case(REFRACTION, {"roughness": 0.0, "ior": 1.5}, is_backfacing=True), wo=at_cosine(0.5))
    assert not none.sample(sobol(6))[0].any()


@pytest.mark.parametrize("roughness", [0.0, 0.1, 0.4, 0.7, 1.0])
@pytest.mark.parametrize("cosine", [1.0, 0.7, 0.3])
def test_white_energy_preserving_lobes_lose_nothing(roughness: float, cosine: float) -> None:
    for node in (DIFFUSE, GLOSSY, GLASS):
        # 0.3%: the tables are interpolated linearly between 16 (glass) or 32 roughnesses.
        albedo = Lobes(Case(node, {"roughness": roughness}), wo=at_cosine(cosine)).albedo(15)
        np.testing.assert_allclose(albedo, 1.0, atol=3e-3, err_msg=f"node {node}")


#: Albedos of roughness 0.9 and colour (0.2, 0.4, 0.8) at a cosine of 1 and of cos(1.2), by Cycles 5.0.1 and 5.3.0: the
#: same of the Diffuse BSDF, of the Principled BSDF without specular light, and of a thin wall that sends all back.
ROUGH_ALBEDOS = {
    0.0: ((0.16029, 0.32958, 0.73705), (0.18263, 0.36919, 0.77245)),
    1.0: ((0.16604, 0.34739, 0.76246), (0.18515, 0.37699, 0.78358)),
}


@pytest.mark.parametrize("tints_by_bounce", ROUGH_ALBEDOS)
@pytest.mark.parametrize(
    "case",
    [
        Case(DIFFUSE, {"roughness": 0.9}),
        Case(PRINCIPLED, {"diffuse_roughness": 0.9, "specular_level": 0.0, "roughness": 1.0}),
        Case(
            PRINCIPLED,
            {
                **{"diffuse_roughness": 0.9, "specular_level": 0.0, "roughness": 1.0},
                **{"thin_wall": 1.0, "subsurface": 1.0, "anisotropy": -1.0},
            },
        ),
    ],
    ids=["diffuse", "principled", "leaf"],
)
def test_rough_diffuse_is_tinted_as_in_the_version_that_renders(case: Case, tints_by_bounce: float) -> None:
    inputs = {**case.inputs, "color": (0.2, 0.4, 0.8), "tints_by_bounce": tints_by_bounce}
    for cosine, expected in zip((1.0, np.cos(1.2)), ROUGH_ALBEDOS[tints_by_bounce], strict=True):
        albedo = Lobes(Case(case.node, inputs), wo=at_cosine(cosine)).albedo(14)
        np.testing.assert_allclose(albedo, expected, rtol=1e-3)


@pytest.mark.parametrize(
    "inputs",
    [
        {},
        {"roughness": 0.1},
        {"metallic": 1.0, "roughness": 0.8},
        {"transmission": 1.0, "roughness": 0.6},
        {"coat_weight": 1.0},
        {"sheen_weight": 1.0},
        {"alpha": 0.5},
        {"specular_level": 1.0},
        {"diffuse_roughness": 1.0},
    ],
    ids=str,
)
def test_white_principled_neither_gains_nor_loses_much(inputs: dict[str, float]) -> None:
    for cosine in (1.0, 0.6, 0.3):
        albedo = Lobes(Case(PRINCIPLED, inputs), wo=at_cosine(cosine)).albedo(14)
        # Layers are weighed by tables that assume lossless lobes below: Cycles' model is within 1% of white.
        assert (albedo < 1.005).all() and (albedo > 0.98).all(), (cosine, albedo)


@pytest.mark.parametrize(
    "case",
    [
        Case(DIFFUSE),
        Case(DIFFUSE, {"roughness": 0.8}),
        Case(GLOSSY, {"roughness": 0.5}, GGX),
        Case(GLOSSY, {"roughness": 0.5, "anisotropic": 0.5}, GGX),
    ],
    ids=str,
)
def test_reflection_is_reciprocal(case: Case) -> None:
    rng = np.random.default_rng(3)
    for _ in range(20):
        a, b = (vector(*(rng.normal(size=2)), abs(rng.normal()) + 0.1) for _ in range(2))
        there = Lobes(case, wo=a).evaluate(np.array([b]))[1][0] / b[2]
        back = Lobes(case, wo=b).evaluate(np.array([a]))[1][0] / a[2]
        np.testing.assert_allclose(there, back, rtol=2e-5)


def test_refraction_is_reciprocal_but_for_radiance_scaling() -> None:
    ior = 1.4
    front = Lobes(Case(GLASS, {"roughness": 0.6, "ior": ior}, GGX), wo=at_cosine(0.7))
    _pdfs, directions, labels, values = front.sample(sobol(8))
    checked = 0
    for wi, label, value in zip(directions, labels, values, strict=True):
        if label & RAY_TRANSMIT and wi[2] < -0.1:
            behind = Lobes(
                Case(GLASS, {"roughness": 0.6, "ior": ior}, GGX, is_backfacing=True),
                wo=vector(*wi),
                ng=vector(0, 0, -1),
                ns=vector(0, 0, -1),
                n=vector(0, 0, -1),
            )
            back = behind.evaluate(np.array([front.wo]))[1][0] / front.wo[2]
            # f(wo, wi) / eta_o^2 = f(wi, wo) / eta_i^2 (Veach 1997, Eq. 5.14), radiance is carried.
            np.testing.assert_allclose(value / -wi[2] / ior**2, back, rtol=2e-4)
            checked += 1
    assert checked > 50


def test_rough_lobes_approach_the_delta_lobe() -> None:
    wo = at_cosine(0.6, 0.3)
    for node in (GLOSSY, REFRACTION, GLASS):
        smooth = Lobes(Case(node, {"roughness": 0.0}), wo=wo).sample(sobol(8))
        nearly = Lobes(Case(node, {"roughness": 0.03}), wo=wo).sample(sobol(8))
        assert (nearly[2] & RAY_SINGULAR == 0).all()
        same_branch = (smooth[2] ^ nearly[2]) & (RAY_REFLECT | RAY_TRANSMIT) == 0
        assert same_branch.mean() > 0.98
        np.testing.assert_allclose(nearly[1][same_branch], smooth[1][same_branch], atol=0.03)
        ratio = nearly[3] / nearly[0][:, None]
        np.testing.assert_allclose(ratio[same_branch], 1.0, atol=0.02)


def test_summary() -> None:
    def summary(*cases: Case) -> int:
        return Lobes(*cases, wo=UP).summary()

    assert summary(Case(DIFFUSE)) == HAS_EVAL
    assert summary(Case(TRANSLUCENT)) == HAS_EVAL | HAS_TRANSMISSION
    assert summary(Case(GLASS, {"roughness": 0.0})) == HAS_DELTA
    assert summary(Case(GLASS, {"roughness": 0.5})) == HAS_EVAL | HAS_TRANSMISSION
    assert summary(Case(TRANSPARENT), Case(GLOSSY, {"roughness": 0.5})) == HAS_EVAL | HAS_TRANSPARENT


def test_hidden_kinds_count_into_the_density_only() -> None:
    lobes = Lobes(Case(DIFFUSE), Case(GLOSSY, {"roughness": 0.5}), wo=at_cosine(0.8))
    wi = np.array([at_cosine(0.7, 2.0)])
    pdf, both = lobes.evaluate(wi)
    for visibility, case in ((RAY_DIFFUSE, Case(DIFFUSE)), (RAY_GLOSSY, Case(GLOSSY, {"roughness": 0.5}))):
        hidden_pdf, one = lobes.evaluate(wi, visibility)
        np.testing.assert_array_equal(hidden_pdf, pdf)
        np.testing.assert_allclose(one, Lobes(case, wo=lobes.wo).evaluate(wi)[1], rtol=1e-6)
        assert (one < both).all()


def test_delta_lobes_keep_their_share_of_the_choice() -> None:
    wi = np.array([at_cosine(0.7, 2.0)])
    alone = Lobes(Case(DIFFUSE), wo=UP).evaluate(wi)[0]
    mixed = Lobes(Case(DIFFUSE), Case(TRANSPARENT), wo=UP).evaluate(wi)[0]
    np.testing.assert_allclose(mixed, 0.5 * alone, rtol=1e-6)


def test_transparent_closures_share_one_lobe() -> None:
    lobes = Lobes(*[Case(TRANSPARENT, {"color": (0.1, 0.2, 0.3)})] * 3, wo=UP)
    assert lobes.closures.count[0] == 1
    np.testing.assert_allclose(lobes.closures.transparency[0, :3], (0.3, 0.6, 0.9), rtol=1e-6)
    pdfs, directions, _labels, values = lobes.sample(sobol(3))
    np.testing.assert_allclose(values / pdfs[:, None], [(0.3, 0.6, 0.9)] * 8, rtol=1e-6)
    np.testing.assert_allclose(directions, [(0.0, 0.0, -1.0)] * 8)


def test_bumped_lobes_do_not_leak_light_through_the_surface() -> None:
    bumped = vector(0.8, 0.0, 0.6)
    below = np.array([at_cosine(-0.2)])  # before the bumped normal, behind the surface
    for case in (Case(DIFFUSE), Case(GLOSSY, {"roughness": 0.7})):
        assert not Lobes(case, wo=UP, n=bumped).evaluate(below)[1].any()
    grazing = np.array([at_cosine(0.1)])
    softened = Lobes(Case(DIFFUSE), wo=UP, n=bumped).evaluate(grazing)[1]
    plain = Lobes(Case(DIFFUSE), wo=UP, n=bumped, flags=1).evaluate(grazing)[1]
    assert (softened < plain).all() and (softened > 0.0).all()


def test_what_a_bumped_lobe_sends_through_the_surface_is_not_softened() -> None:
    """As in Cycles: of a translucent one light samples are, and its own samples are not."""
    lobes = Lobes(Case(TRANSLUCENT), wo=UP, n=vector(0.8, 0.0, 0.6))
    pdfs, directions, _labels, values = lobes.sample(sobol(6))
    is_valid = pdfs > 0.0
    assert is_valid.sum() > 32
    np.testing.assert_allclose(values[is_valid], np.repeat(pdfs[is_valid, None], 3, axis=1), rtol=1e-6)
    assert lobes.evaluate(directions[is_valid])[1].sum() < 0.9 * values[is_valid].sum()


def test_specular_normals_are_lifted_until_the_mirror_direction_leaves() -> None:
    wo = at_cosine(0.15)
    lobes = Lobes(Case(PRINCIPLED, {"metallic": 1.0, "roughness": 0.0}), wo=wo, n=vector(-0.5, 0.0, 0.8))
    pdfs, directions, _labels, _values = lobes.sample(sobol(4))
    assert (pdfs > 0.0).all() and (directions[:, 2] > 0.0).all()
    np.testing.assert_allclose(directions[:, 2], 0.01, atol=1e-4)


def test_caustics_switched_off_drop_specular_lobes() -> None:
    reflective, refractive = 2, 4
    case = Case(PRINCIPLED, {"coat_weight": 1.0, "metallic": 0.5})
    assert Lobes(case, wo=UP, flags=reflective).closures.count[0] == 1
    glass = Case(GLASS, {"roughness": 0.0})
    assert Lobes(glass, wo=UP, flags=reflective | refractive).closures.count[0] == 0
    labels = Lobes(glass, wo=UP, flags=refractive).sample(sobol(6))[2]
    assert (labels & RAY_REFLECT != 0).all()


def test_weights_that_are_no_numbers_are_dropped() -> None:
    for bad in (np.nan, np.inf, -1.0, 0.0):
        assert Lobes(Case(DIFFUSE, {"color": (bad, bad, bad)}), wo=UP).closures.count[0] == 0


def test_a_full_list_ignores_further_closures() -> None:
    lobes = Lobes(*[Case(DIFFUSE)] * 20, wo=UP)
    assert lobes.closures.count[0] == lobes.closures.kind.shape[1]
    assert lobes.sample(sobol(4))[0].all()
