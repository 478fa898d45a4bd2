# SPDX-License-Identifier: GPL-3.0-or-later
"""Kernels of decoded mixtures: sampling against density over all parameters, and what must not break them."""

from functools import partial

import numpy as np
import pytest

from engine.guiding.fields.vmm.field import (
    GUIDE_COEFFICIENT,
    GUIDE_KAPPA,
    GUIDE_WEIGHT,
    GUIDE_X,
    GUIDE_Z,
)
from engine.guiding.neural.networks.lobes.nasg import (
    LOG_A_LOW,
    NASG_A,
    NASG_COEFFICIENT,
    NASG_LAMBDA,
    NASG_LOG_A,
    NASG_LOG_LAMBDA,
)
from engine.guiding.neural.networks.lobes.vmf import (
    LOG_KAPPA_LOW,
    LOGIT_HIGH,
    VMF_LOG_KAPPA,
    VMF_OUTPUTS,
)
from tests.helpers import chi2
from tests.helpers.guiding_harness import (
    FAR,
    densities,
    field_of,
    guide_at,
    sphere_grid,
    uniform_directions,
    unit,
    vmf_density,
)
from tests.helpers.lobe_mixtures import (
    A_CAP,
    CAP,
    ECCENTRICITIES,
    HOSTILE,
    KAPPAS,
    ORIENTATIONS,
    OUTPUTS,
    Mixtures,
    from_quantiles,
    outputs_of,
)

#: Family-wise significance of each chi-square test over its parameters.
SIGNIFICANCE = 0.01
UNIFORM = 0.25 / np.pi


def nasg_density(directions, kappa, a, axes, epsilon=0.0):
    """Eqs. (19) and (30) of the paper, in float64; not at the poles themselves."""
    x, _, z = axes
    cosine = directions @ z
    g = 0.5 * (1.0 + cosine)
    q = epsilon + a * (directions @ x) ** 2 / (1.0 - cosine**2)
    norm = kappa * np.sqrt((1.0 + epsilon) * (1.0 + epsilon + a)) / (2.0 * np.pi * -np.expm1(-2.0 * kappa))
    return norm * np.exp(2.0 * kappa * (g ** (1.0 + q) - 1.0)) * g**q


def to_quantiles(directions, kappa, a, axes):
    """The inverse of `from_quantiles`: (s, rho)."""
    directions = directions.astype(np.float64)
    chord = directions - axes[2]
    h = 0.25 * (chord**2).sum(-1)
    x, y = chord @ axes[0], directions @ axes[1]
    power = 1.0 + a * x**2 / (x**2 + y**2 + 1e-300)
    below = -np.expm1(power * np.log1p(-np.minimum(h, 1.0 - 1e-15)))
    s = np.expm1(-2.0 * kappa * below) / np.expm1(-2.0 * kappa) if kappa > 0.0 else below
    return s, np.arctan2(y / np.sqrt(1.0 + a), x) % (2.0 * np.pi)


def quantile_cells(mixtures, rows=12, columns=16, points=6):
    """Integrals of the kernels' density over cells of a single lobe's quantiles."""
    nodes, weights = np.polynomial.legendre.leggauss(points)
    nodes, weights = 0.5 * (nodes + 1.0), 0.5 * weights
    s = (np.arange(rows)[:, None] + nodes).ravel() / rows
    rho = 2.0 * np.pi * (np.arange(columns)[:, None] + nodes).ravel() / columns
    directions, measure = from_quantiles(*(g.ravel() for g in np.meshgrid(s, rho, indexing="ij")), *mixtures.lobe())
    density = (mixtures.pdf(directions) * measure).reshape(rows, points, columns, points)
    return np.einsum("aibj,i,j->ab", density, weights, weights) * 2.0 * np.pi / (rows * columns)


# ---------------------------------------------------------------------------------------------------------------------
# Sampling and density

SINGLE = [("vmf", kappa, 0.0) for kappa in KAPPAS]
SINGLE += [("nasg", kappa, a) for kappa in KAPPAS for a in ECCENTRICITIES]


@pytest.mark.parametrize("case", range(len(SINGLE)))
def test_single_lobes_integrate_to_one_and_are_sampled_by_their_density(case):
    model, kappa, a = SINGLE[case]
    raw = outputs_of(model, kappa, a or 1.0, ORIENTATIONS[case % len(ORIENTATIONS)])
    mixtures = Mixtures(model, [raw])
    assert mixtures.lobe()[0] == pytest.approx(kappa, rel=1e-5)
    assert mixtures.lobe()[1] == pytest.approx(a, rel=1e-5)
    probability = quantile_cells(mixtures)
    assert probability.sum() == pytest.approx(1.0, abs=1e-4)
    assert np.allclose(probability * probability.size, 1.0, atol=2e-3)

    count = 60_000
    drawn = mixtures.sample(count)
    assert np.abs(np.linalg.norm(drawn.astype(np.float64), axis=1) - 1.0).max() < 2e-6
    assert mixtures.pdf(drawn).min() > 0.0
    s, rho = to_quantiles(drawn, *mixtures.lobe())
    observed = np.histogram2d(s, rho, probability.shape, [[0.0, 1.0], [0.0, 2.0 * np.pi]])[0]
    assert chi2.p_value(observed, probability, count) > chi2.sidak(SIGNIFICANCE, len(SINGLE))


@pytest.mark.parametrize("kappa", [0.0, *KAPPAS[:4]])
@pytest.mark.parametrize("a", [0.0, 5e-5, 0.5, 10.0])
def test_the_density_integrates_to_one_over_the_sphere(kappa, a):
    """Without any of a lobe's own coordinates. What 0 stands for is set by hand: outputs do not reach it."""
    mixtures = Mixtures("nasg", [outputs_of("nasg")])
    kappa_0, a_0, _ = mixtures.lobe()
    spreads = [-np.expm1(-2.0 * value) / (2.0 * value) if value > 0.0 else 1.0 for value in (kappa_0, kappa)]
    mixtures.guide.lobes[0, NASG_COEFFICIENT] *= spreads[0] / spreads[1] * np.sqrt((1.0 + a) / (1.0 + a_0))
    mixtures.guide.lobes[0, NASG_LAMBDA] = kappa
    mixtures.guide.lobes[0, NASG_A] = a
    integrals = chi2.cell_integrals(mixtures.pdf, 12, 24, points=6, subdivisions=3)
    # At the tip opposite to z the density has no limit, and quadrature with equal cells is coarse there.
    assert integrals.sum() == pytest.approx(1.0, abs=2e-3)
    drawn = mixtures.sample(100_000)
    observed = chi2.histogram(drawn, 12, 24)
    assert chi2.p_value(observed, integrals / integrals.sum(), len(drawn)) > chi2.sidak(SIGNIFICANCE, 20)


@pytest.mark.parametrize("model, lobe_count", [("vmf", 8), ("vmf", 14), ("vmf", 1), ("nasg", 8), ("nasg", 5)])
def test_mixtures_are_sampled_by_their_density(model, lobe_count):
    rng = np.random.default_rng(4)
    raw = rng.normal(size=(3, 2 + lobe_count * OUTPUTS[model]))
    mixtures = Mixtures(model, raw, lobe_count, first=2)
    assert np.allclose(mixtures.weights.sum(1), 1.0, atol=1e-6)
    assert (mixtures.guide.lobes[:, :, lobe_count : mixtures.guide.count[0]] == 0.0).all()
    count = 200_000
    for lane in range(3):
        drawn = mixtures.sample(count, lane)
        probability = chi2.cell_integrals(partial(mixtures.pdf, lane=lane), 20, 40, points=4, subdivisions=3)
        assert probability.sum() == pytest.approx(1.0, abs=2e-3)
        probability /= probability.sum()
        assert chi2.p_value(chi2.histogram(drawn, 20, 40), probability, count) > chi2.sidak(SIGNIFICANCE, 15)


@pytest.mark.parametrize("model", OUTPUTS)
def test_every_draw_has_a_density_in_any_mixture(model):
    rng = np.random.default_rng(5)
    raw = rng.normal(size=(400, 8 * OUTPUTS[model])) * 10.0 ** rng.uniform(-1.0, 2.0, (400, 1))
    mixtures = Mixtures(model, raw)
    edges = [0.0, 2.0**-24, 0.25, 0.5, 0.75, 1.0 - 2.0**-24]
    corners = np.stack([g.ravel() for g in np.meshgrid(edges, edges, edges)], -1)
    u = np.concatenate([corners, rng.random((400, 3))])
    for lane in range(len(raw)):
        drawn = mixtures.sample(u, lane)
        assert np.abs(np.linalg.norm(drawn.astype(np.float64), axis=1) - 1.0).max() < 2e-6
        pdf = mixtures.pdf(drawn, lane)
        assert np.isfinite(pdf).all() and pdf.min() > 0.0


@pytest.mark.parametrize("kappa", KAPPAS)
@pytest.mark.parametrize("a", ECCENTRICITIES)
def test_nasg_is_the_papers_density(kappa, a):
    mixtures = Mixtures("nasg", [outputs_of("nasg", kappa, a)])
    kappa, eccentricity, axes = mixtures.lobe()
    # A float32 axis is longer or shorter than 1 by what a narrow lobe's cosine would notice.
    z = unit(axes[2])
    x = unit(axes[0] - (axes[0] @ z) * z)
    lobe = kappa, eccentricity, np.stack([x, np.cross(z, x), z])
    rng = np.random.default_rng(6)
    near, _ = from_quantiles(rng.random(2000) * 0.9999, rng.random(2000) * 2.0 * np.pi, *lobe)
    directions = np.concatenate([near, uniform_directions(rng, 2000)]).astype(np.float32).astype(np.float64)
    found = mixtures.pdf(directions)
    assert np.isfinite(found).all() and (found >= 0.0).all()
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    exact = nasg_density(directions, *lobe)
    is_normal = exact > 1e-30
    error = np.abs(np.log(found[is_normal]) - np.log(exact[is_normal]))
    assert error[:2000].max() < 2e-5
    assert error.max() < 1e-4
    # The epsilon of appendix A changes nothing that float32 could show.
    if a == 25.0:
        smoothed = nasg_density(directions, *lobe, epsilon=5e-6)
        assert np.allclose(smoothed[is_normal], exact[is_normal], rtol=2e-3)


@pytest.mark.parametrize("kappa", KAPPAS)
def test_nasg_without_eccentricity_is_von_mises_fisher(kappa):
    mixtures = Mixtures("nasg", [outputs_of("nasg", kappa, a=1.0)])
    mixtures.guide.lobes[0, NASG_COEFFICIENT] /= np.sqrt(1.0 + mixtures.guide.lobes[0, NASG_A, 0])
    mixtures.guide.lobes[0, NASG_A] = 0.0
    kappa, _, axes = mixtures.lobe()
    round_one = Mixtures("vmf", [outputs_of("vmf", kappa)])
    round_one.guide.lobes[0, GUIDE_X : GUIDE_Z + 1, 0] = axes[2]
    rng = np.random.default_rng(7)
    near, _ = from_quantiles(rng.random(2000) * 0.999, rng.random(2000) * 6.0, kappa, 0.0, axes)
    directions = np.concatenate([near, uniform_directions(rng, 1000), axes[2:], -axes[2:]])
    expected = round_one.pdf(directions)
    assert np.allclose(mixtures.pdf(directions), expected, rtol=2e-5, atol=1e-30)
    assert np.allclose(expected[:2000], vmf_density(near, axes[2], kappa), rtol=2e-3)
    u = rng.random((2000, 3))
    assert np.allclose(
        to_quantiles(mixtures.sample(u), kappa, 0.0, axes)[0], 1.0 - u[:, 1].astype(np.float32), atol=2e-3
    )


@pytest.mark.parametrize("kappa", [1e-2, 1.0, 6.0])
@pytest.mark.parametrize("a", [0.5, 25.0, A_CAP])
def test_limits_at_the_poles(kappa, a):
    mixtures = Mixtures("nasg", [outputs_of("nasg", kappa, a)])
    kappa, a, (x, y, z) = mixtures.lobe()
    norm = np.sqrt(1.0 + a) * kappa / (2.0 * np.pi * -np.expm1(-2.0 * kappa))
    assert mixtures.pdf(z[None])[0] == pytest.approx(norm, rel=1e-4)
    # Along +-y the density goes to exp(-2 lambda) / K, which is the value at -z itself; elsewhere to 0 as g^(a cos^2).
    for step in (0.0, 1e-7, 1e-5, 1e-4):
        for sign in (-1.0, 1.0):
            near = mixtures.pdf(unit(-z + sign * step * y)[None])[0]
            assert near == pytest.approx(norm * np.exp(-2.0 * kappa), rel=0.1)
    steps = np.array([0.3, 0.1, 0.03, 0.01])
    along = [unit(-z + step * (x + y)) for step in steps]
    found = mixtures.pdf(along).astype(np.float64)
    g = np.array([0.5 * (1.0 + d @ z) for d in along])
    expected = norm * np.exp(-2.0 * kappa) * g ** (0.5 * a)
    is_normal = expected > 1e-30
    assert np.allclose(found[is_normal][-2:], expected[is_normal][-2:], rtol=0.02)
    assert (np.diff(found) <= 0.0).all()
    nearest = mixtures.pdf(unit(-z + 1e-3 * x)[None])[0]
    assert nearest <= found[-1] or nearest < norm * np.exp(-2.0 * kappa) * 1e-6 ** (0.9 * a)


# ---------------------------------------------------------------------------------------------------------------------
# Outputs of any kind


@pytest.mark.parametrize("model", OUTPUTS)
def test_broken_outputs_give_valid_mixtures(model):
    rng = np.random.default_rng(8)
    width = 8 * OUTPUTS[model]
    raw = rng.normal(size=(600, width)) * 3.0
    for row, share in enumerate(np.linspace(0.02, 1.0, 600)):
        chosen = rng.random(width) < share
        raw[row, chosen] = rng.choice(HOSTILE, chosen.sum())
    with np.errstate(over="ignore"):
        mixtures = Mixtures(model, raw)
    guide = mixtures.guide
    assert np.isfinite(guide.lobes[:, :, :8]).all()
    assert np.allclose(mixtures.weights.sum(1), 1.0, atol=1e-6)
    directions = uniform_directions(rng, 300)
    for lane in range(len(raw)):
        drawn = mixtures.sample(300, lane)
        assert np.abs(np.linalg.norm(drawn.astype(np.float64), axis=1) - 1.0).max() < 2e-6
        at_drawn, predicted = mixtures.query(drawn, lane)
        assert np.isfinite(at_drawn).all() and at_drawn.min() > 0.0
        assert np.isfinite(predicted).all() and predicted.min() > 0.0
        elsewhere = mixtures.pdf(directions, lane)
        assert np.isfinite(elsewhere).all() and elsewhere.min() >= 0.0
        assert mixtures.pdf(np.concatenate([directions, drawn]), lane).max() < 1e6


@pytest.mark.parametrize("model", OUTPUTS)
def test_a_lobe_with_nan_is_uniform(model):
    directions = sphere_grid(20, 40)
    outputs = OUTPUTS[model]
    for column in range(outputs):
        raw = np.full((1, 8 * outputs), 0.3)
        raw[0, column::outputs] = np.nan
        assert np.allclose(Mixtures(model, raw).pdf(directions), UNIFORM, rtol=1e-6)
        one = np.concatenate([outputs_of(model, 20.0, 3.0, logit=1.0), np.full(outputs, 9.0)])
        one[outputs + column] = np.nan
        share = np.exp(1.0) / (1.0 + np.exp(1.0))
        alone = Mixtures(model, one[None, :outputs]).pdf(directions)
        found = Mixtures(model, one[None]).pdf(directions)
        assert np.allclose(found, share * alone + (1.0 - share) * UNIFORM, rtol=1e-5)


@pytest.mark.parametrize("model", OUTPUTS)
def test_outputs_are_clamped_at_both_ends(model):
    for output, kappa in ((-1e9, np.exp(float(LOG_KAPPA_LOW))), (1e9, CAP)):
        raw = outputs_of(model)
        raw[VMF_LOG_KAPPA if model == "vmf" else NASG_LOG_LAMBDA] = output
        assert Mixtures(model, [raw]).lobe()[0] == pytest.approx(kappa, rel=1e-5)
    for output, a in ((-1e9, np.exp(float(LOG_A_LOW))), (1e9, A_CAP)) if model == "nasg" else ():
        raw = outputs_of(model)
        raw[NASG_LOG_A] = output
        assert Mixtures(model, [raw]).lobe()[1] == pytest.approx(a, rel=1e-5)
    raw = np.concatenate([outputs_of(model, logit=1e20), outputs_of(model, logit=-1e20)])
    assert Mixtures(model, [raw]).weights[0, 1] == pytest.approx(np.exp(-25.0), rel=1e-4)
    raw = np.concatenate([outputs_of(model, logit=1e20), outputs_of(model, logit=float(LOGIT_HIGH))])
    assert np.allclose(Mixtures(model, [raw]).weights[0, :2], 0.5)


def test_broken_directions_and_fluence_do_no_harm():
    directions = np.array([[np.nan, 0, 1], [np.inf, 0, 0], [1e30, 1e30, 0], [0, 0, 0], [-np.inf, np.inf, np.nan]])
    raw = np.random.default_rng(9).normal(size=(1, 64)) * 4.0
    found = Mixtures("nasg", raw).pdf(directions)
    assert np.isfinite(found).all() and (found >= 0.0).all()
    good = uniform_directions(np.random.default_rng(10), 100)
    for model in OUTPUTS:
        for fluence, sane in ((np.nan, 0.0), (-1.0, 0.0), (-np.inf, 0.0), (np.inf, 1e30), (3e38, 1e30), (2.0, 2.0)):
            pdf, predicted = Mixtures(model, raw, fluence=fluence).query(good)
            assert np.allclose(predicted, sane * (0.7 * pdf.astype(np.float64) + 0.3 * UNIFORM), rtol=1e-5)


# ---------------------------------------------------------------------------------------------------------------------
# The product with the cosine


def test_product_with_the_cosine():
    rng = np.random.default_rng(11)
    directions = sphere_grid(120, 240)
    for lobe_count in (8, 14):
        raw = rng.normal(size=(6, lobe_count * VMF_OUTPUTS))
        raw[5, :VMF_OUTPUTS] = np.nan
        plain = Mixtures("vmf", raw, fluence=3.0)
        product = Mixtures("vmf", raw, fluence=3.0)
        normals = uniform_directions(rng, 6)
        product.multiply_cosine(normals)
        for lane in range(6):
            pdf, predicted = plain.query(directions, lane)
            expected = pdf * vmf_density(directions, normals[lane], 2.18853)
            expected /= expected.mean() * 4.0 * np.pi
            found, found_predicted = product.query(directions, lane)
            assert np.allclose(found, expected, rtol=3e-3, atol=1e-6)
            assert np.allclose(found_predicted, predicted, rtol=2e-4)
            assert product.weights[lane].sum() == pytest.approx(1.0, abs=1e-6)
    count = 200_000
    probability = chi2.cell_integrals(partial(product.pdf, lane=5), 20, 40, points=4, subdivisions=3)
    observed = chi2.histogram(product.sample(count, 5), 20, 40)
    assert chi2.p_value(observed, probability / probability.sum(), count) > SIGNIFICANCE


def test_product_is_that_of_the_field():
    raw = np.random.default_rng(12).normal(size=(1, 8 * VMF_OUTPUTS))
    mixtures = Mixtures("vmf", raw)
    lobes = mixtures.guide.lobes[0].astype(np.float64)
    field = field_of(
        [(lobes[GUIDE_WEIGHT, k], lobes[GUIDE_KAPPA, k], lobes[GUIDE_X : GUIDE_Z + 1, k], FAR) for k in range(8)]
    )
    n = unit((0.2, 0.5, 0.7))
    mixtures.multiply_cosine(n[None])
    directions = sphere_grid(50, 100)
    expected, _ = densities(guide_at(field, (0.0, 0.0, 0.0), n, True), directions)
    assert np.allclose(mixtures.pdf(directions), expected, rtol=2e-4)
    expected_coefficients = guide_at(field, (0.0, 0.0, 0.0), n, True).lobes[0, GUIDE_COEFFICIENT, :8]
    assert np.allclose(mixtures.guide.lobes[0, GUIDE_COEFFICIENT, :8], expected_coefficients, rtol=2e-4)


def test_no_product_with_what_is_no_direction():
    raw = np.random.default_rng(13).normal(size=(4, 8 * VMF_OUTPUTS))
    mixtures = Mixtures("vmf", raw)
    before = mixtures.guide.lobes.copy(), mixtures.guide.cosine.copy()
    mixtures.multiply_cosine([[np.nan, 0, 1], [0, 0, 0], [np.inf, 0, 0], [1e25, 0, 0]])
    assert (mixtures.guide.lobes == before[0]).all() and (mixtures.guide.cosine == before[1]).all()


def test_products_of_extremes_stay_valid():
    """Narrowest and widest lobes, along the normal and against it, where concentrations cancel too."""
    kappas = [*KAPPAS, 2.18853]
    directions = sphere_grid(10, 20)
    for kappa in kappas:
        mixtures = Mixtures("vmf", [outputs_of("vmf", kappa)])
        mean = mixtures.lobe()[2][2]
        for n in (mean, -mean, np.cross(mean, unit((1, 2, 3)))):
            product = Mixtures("vmf", [outputs_of("vmf", kappa)])
            product.multiply_cosine(unit(n)[None])
            assert np.isfinite(product.guide.lobes).all() and np.isfinite(product.guide.cosine).all()
            drawn = product.sample(500)
            assert product.pdf(drawn).min() > 0.0
            pdf, predicted = product.query(np.concatenate([drawn, directions]))
            assert np.isfinite(pdf).all() and np.isfinite(predicted).all()
