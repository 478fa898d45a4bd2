# SPDX-License-Identifier: GPL-3.0-or-later
"""The mixture field: sampling against density, fitting, the tree, and what must not break it."""

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from engine.guiding.fields.vmm.field import LOBE_KAPPA, LOBE_WEIGHT, LOBE_X, LOBE_Z
from engine.guiding.fields.vmm.model import VmmModel, VmmSettings
from tests.helpers import chi2
from tests.helpers.guiding_harness import (
    densities,
    divergence,
    field_of,
    guide_at,
    make_records,
    mixture_density,
    regions,
    samples,
    sphere_grid,
    uniform_directions,
    uniform_records,
    unit,
    vmf_density,
)

BOX = ((-1.0, -1.0, -1.0), (1.0, 1.0, 1.0))
FAR = 1e30
#: Family-wise significance of the chi-square tests.
SIGNIFICANCE = 0.01

#: One region, and lobes merged as soon as Open PGL would: no more lobes than the truth has.
PARSIMONIOUS = VmmSettings(10**9, merge_threshold=0.025)

MIXTURE = [
    (0.5, 3.0, (0.3, 0.1, 0.9), FAR),
    (0.3, 40.0, (-0.8, 0.2, 0.1), 2.0),
    (0.15, 0.0, (0.0, 0.0, 1.0), FAR),
    (0.05, 150.0, (0.1, -0.9, -0.5), 0.7),
]


# ---------------------------------------------------------------------------------------------------------------------
# Sampling and density


@pytest.mark.parametrize("cosine_lobe", [False, True])
@pytest.mark.parametrize("p", [(0.0, 0.0, 0.0), (0.4, -0.3, 0.2)])
def test_samples_of_a_mixture_follow_its_density(cosine_lobe, p):
    guide = guide_at(field_of(MIXTURE), p, (0.2, 0.5, 0.7), cosine_lobe)
    count = 200_000
    drawn = samples(guide, np.random.default_rng(1), count)
    assert np.abs(np.linalg.norm(drawn, axis=1) - 1.0).max() < 1e-5
    probability = chi2.cell_integrals(lambda d: densities(guide, d)[0], 24, 48, points=4, subdivisions=4)
    assert probability.sum() == pytest.approx(1.0, abs=1e-3)
    assert chi2.p_value(chi2.histogram(drawn, 24, 48), probability, count) > chi2.sidak(SIGNIFICANCE, 4)


@pytest.mark.parametrize("kappa", [0.0, 1e-3, 0.02, 1.0, 50.0, 1e3, 1e4, 32000.0])
@pytest.mark.parametrize("cosine_lobe", [False, True])
def test_narrow_lobes_lose_no_mass(kappa, cosine_lobe):
    """Rings of equal probability around the mean, of which each must get its share; the density integrates to one."""
    mean = unit((0.3, -0.5, 0.8))
    guide = guide_at(field_of([(1.0, kappa, mean, FAR)]), (0, 0, 0), (0.2, 0.5, 0.7), cosine_lobe)
    center = guide.lobes[0, 2:5, 0].astype(np.float64)
    actual = float(guide.lobes[0, 1, 0])
    count, rings = 100_000, 64
    drawn = samples(guide, np.random.default_rng(2), count)
    below = 0.5 * ((drawn - center) ** 2).sum(1)
    if actual > 0.0:
        edges = -np.log1p(np.arange(rings) / rings * np.expm1(-2.0 * actual)) / actual
        edges = np.append(edges, 2.0)
    else:
        edges = 2.0 * np.arange(rings + 1) / rings
    nodes, weights = np.polynomial.legendre.leggauss(16)
    a = unit(np.cross(center, (1.0, 0.0, 0.0)))
    b = np.cross(center, a)
    probability = np.zeros(rings)
    for ring in range(rings):
        low, high = edges[ring], edges[ring + 1]
        if ring == rings - 1:
            high = min(high, low + 40.0 / max(actual, 1e-9))
        t = 0.5 * (low + high) + 0.5 * (high - low) * nodes
        sine = np.sqrt(t * (2.0 - t))
        for phi in np.linspace(0.0, 2.0 * np.pi, 8, endpoint=False):
            axis = np.cos(phi) * a + np.sin(phi) * b
            pdf, _ = densities(guide, sine[:, None] * axis + (1.0 - t)[:, None] * center)
            probability[ring] += (pdf * weights).sum() * 0.5 * (high - low) * 2.0 * np.pi / 8
    assert probability.sum() == pytest.approx(1.0, abs=3e-4)
    observed = np.histogram(below, edges)[0]
    assert chi2.p_value(observed, probability, count) > chi2.sidak(SIGNIFICANCE, 16)


def test_density_is_the_mixture_at_the_pivot_and_the_product_elsewhere():
    directions = sphere_grid(100, 200)
    lobes = [lobe[:3] for lobe in MIXTURE]
    plain, _ = densities(guide_at(field_of(MIXTURE), (0, 0, 0)), directions)
    assert np.allclose(plain, mixture_density(directions, lobes), rtol=2e-4, atol=1e-6)
    normal = unit((0.2, 0.5, 0.7))
    product, _ = densities(guide_at(field_of(MIXTURE), (0, 0, 0), normal, True), directions)
    expected = mixture_density(directions, lobes) * vmf_density(directions, normal, 2.18853)
    expected /= expected.mean() * 4.0 * np.pi
    assert np.allclose(product, expected, rtol=3e-3, atol=1e-5)


def test_prediction_is_fluence_times_density_without_the_cosine_and_partly_even():
    directions = sphere_grid(100, 200)
    field = field_of(MIXTURE, fluence=7.0)
    plain, _ = densities(guide_at(field, (0.1, 0.2, 0.0)), directions)
    for cosine_lobe in (False, True):
        _, predicted = densities(guide_at(field, (0.1, 0.2, 0.0), (0.2, 0.5, 0.7), cosine_lobe), directions)
        expected = 7.0 * (0.7 * plain + 0.3 / (4 * np.pi))
        assert np.allclose(predicted, expected, rtol=1e-3, atol=1e-5)


def test_lobes_turn_towards_their_light():
    field = field_of([(1.0, 500.0, (0.0, 0.0, 1.0), 2.0)])
    light = np.array([0.0, 0.0, 2.0])
    for p in ((0.0, 0.0, 0.0), (1.0, 0.0, 0.5), (0.0, -3.0, 1.0)):
        guide = guide_at(field, p)
        assert np.allclose(guide.lobes[0, 2:5, 0], unit(light - np.asarray(p)), atol=1e-5)
    at_light = guide_at(field, light)
    assert np.isfinite(at_light.lobes).all()
    assert np.linalg.norm(at_light.lobes[0, 2:5, 0]) == pytest.approx(1.0, abs=1e-5)


# ---------------------------------------------------------------------------------------------------------------------
# Fitting


def learn(rng, radiance, count, updates=1, settings=None, **box):
    """A model that has seen `updates` batches of uniform records."""
    model = VmmModel(BOX, settings)
    for _ in range(updates):
        model.update(uniform_records(rng, count, radiance, **box), count)
    return model


def test_known_mixtures_are_recovered():
    truth = [(0.5, 40.0, (1.0, 0.2, 0.3)), (0.3, 300.0, (-1.0, 1.0, 0.0)), (0.2, 4.0, (0.0, 0.0, -1.0))]
    model = learn(np.random.default_rng(3), lambda d: mixture_density(d, truth), 40_000, 2, PARSIMONIOUS)
    field = model.field
    assert model.region_count == 1
    assert field.fluence[0] == pytest.approx(1.0, rel=0.05)
    assert divergence(lambda d: mixture_density(d, truth), field) < 0.01
    for weight, kappa, mean in truth:
        near = field.lobes[0, LOBE_X : LOBE_Z + 1].T @ unit(mean) > 0.98
        near &= field.lobes[0, LOBE_WEIGHT] > 0.05
        assert near.sum() == 1
        assert field.lobes[0, LOBE_WEIGHT, near][0] == pytest.approx(weight, abs=0.05)
        assert field.lobes[0, LOBE_KAPPA, near][0] == pytest.approx(kappa, rel=0.25)


def test_weights_follow_radiance_over_density_whatever_the_sampling():
    truth = [(0.6, 30.0, (1.0, 0.0, 0.2)), (0.4, 30.0, (-1.0, 0.3, 0.0))]
    rng = np.random.default_rng(4)
    count = 40_000
    source = field_of([(0.7, 5.0, (-1.0, 0.0, 0.0), FAR), (0.3, 0.0, (0.0, 0.0, 1.0), FAR)])
    directions = samples(guide_at(source, (0, 0, 0)), rng, count)
    pdf, _ = densities(guide_at(source, (0, 0, 0)), directions)
    model = VmmModel(BOX, VmmSettings(10**9))
    records = make_records(rng.uniform(-1, 1, (count, 3)), directions, mixture_density(directions, truth), pdf)
    model.update(records, count)
    assert divergence(lambda d: mixture_density(d, truth), model.field) < 0.01
    assert model.field.fluence[0] == pytest.approx(1.0, rel=0.05)


def test_parallax_of_a_light_near_a_region():
    """A small sphere at (0, 0, 1.5) lights a box two metres wide: each place must find it where it is."""
    light, radius = np.array([0.0, 0.0, 1.5]), 0.1
    rng = np.random.default_rng(5)
    count = 60_000
    positions = rng.uniform((-1, -1, -1), (1, 1, 0.5), (count, 3))
    axis = light - positions
    distance = np.linalg.norm(axis, axis=1)
    # Directions from a cone around the light, density by solid angle; a fifth of the samples go anywhere.
    cosine_max = np.sqrt(1.0 - (2.0 * radius / distance) ** 2)
    inside = rng.random(count) < 0.8
    directions = uniform_directions(rng, count)
    for k in np.flatnonzero(inside):
        w = axis[k] / distance[k]
        a = unit(np.cross(w, (1.0, 0.0, 0.0) if abs(w[0]) < 0.9 else (0.0, 1.0, 0.0)))
        c = 1.0 - rng.random() * (1.0 - cosine_max[k])
        phi = 2.0 * np.pi * rng.random()
        s = np.sqrt(1.0 - c * c)
        directions[k] = c * w + s * np.cos(phi) * a + s * np.sin(phi) * np.cross(w, a)
    cosine = (directions * axis).sum(1) / distance
    pdf = 0.2 * 0.25 / np.pi + 0.8 * (cosine > cosine_max) / (2.0 * np.pi * (1.0 - cosine_max))
    lit = cosine > np.sqrt(1.0 - (radius / distance) ** 2)
    model = VmmModel(((-1, -1, -1), (1, 1, 2)), VmmSettings(10**9))
    model.update(make_records(positions, directions, np.where(lit, 5.0, 0.0), pdf, distance), count)
    for p in ((-0.8, -0.8, 0.0), (0.8, 0.5, 0.2), (0.0, 0.0, -1.0)):
        towards = unit(light - np.asarray(p))
        pdf, _ = densities(guide_at(model.field, p), towards[None])
        # The light covers pi r^2 / d^2: a perfect guide has the inverse of that there.
        perfect = np.sum((light - np.asarray(p)) ** 2) / (np.pi * radius**2)
        assert pdf[0] > 0.2 * perfect
        fixed = field_of([(1.0, 1e-3, (0, 0, 1), FAR)])._replace(
            lobes=model.field.lobes * (np.arange(7) != 5)[None, :, None].astype(np.float32),
            lobe_count=model.field.lobe_count, pivot=model.field.pivot,
        )
        without, _ = densities(guide_at(fixed, p), towards[None])
        assert pdf[0] > 2.0 * without[0] or p == (0.0, 0.0, -1.0)


def test_one_repeated_direction_does_not_collapse_a_lobe():
    count = 20_000
    direction = np.repeat(unit((0.3, 0.4, 0.8))[None], count, 0)
    model = VmmModel(BOX)
    rng = np.random.default_rng(6)
    for _ in range(4):
        model.update(make_records(rng.uniform(-1, 1, (count, 3)), direction, 1.0, 1.0), count)
    assert np.isfinite(model.field.lobes).all()
    assert model.field.lobes[:, LOBE_KAPPA].max() <= model.settings.max_kappa
    for region in range(model.region_count):
        guide = guide_at(model.field, model.field.pivot[region], region=region)
        pdf, _ = densities(guide, direction[:1])
        assert np.isfinite(pdf).all() and pdf[0] > 100.0
        drawn = samples(guide, rng, 100)
        assert np.isfinite(drawn).all()


def test_a_single_bright_sample_does_not_bend_the_field():
    def radiance(d):
        return mixture_density(d, [(0.7, 20.0, (1.0, 0.0, 0.0)), (0.3, 2.0, (0.0, 1.0, 0.0))])

    results = []
    for brightness in (None, 1e6):
        records = uniform_records(np.random.default_rng(7), 4000, radiance)
        if brightness is not None:
            records.radiance[1234] = brightness
            records.direction[1234] = unit((-0.2, -0.1, -1.0))
        model = VmmModel(BOX)
        model.update(records, 4000)
        results.append((divergence(radiance, model.field), model.field.fluence[0]))
    assert results[1][0] < results[0][0] + 0.06
    assert results[1][1] < 1.1 * results[0][1]


def test_light_that_no_lobe_explains_gets_its_own():
    rng = np.random.default_rng(8)
    model = VmmModel(BOX)
    for mean in ((0.0, 0.0, 1.0), (0.0, 0.0, -1.0)):
        directions = samples(guide_at(field_of([(1.0, 3000.0, mean, FAR)]), (0, 0, 0)), rng, 4000)
        model.update(make_records(rng.uniform(-1, 1, (4000, 3)), directions, 1.0, 1.0), 4000)
    pdf, _ = densities(guide_at(model.field, model.field.pivot[0]), np.array([[0, 0, 1.0], [0, 0, -1.0]]))
    assert (pdf > 50.0).all()


def test_the_field_follows_a_change_of_light():
    rng = np.random.default_rng(9)
    settings = VmmSettings(10**9, statistics_limit=8000.0)
    model = learn(rng, lambda d: vmf_density(d, (1, 0, 0), 30.0), 8000, 3, settings)
    new = [(1.0, 30.0, (0.0, 1.0, 0.0))]
    pdfs = []
    for _ in range(6):
        model.update(uniform_records(rng, 8000, lambda d: mixture_density(d, new)), 8000)
        pdfs.append(densities(guide_at(model.field, (0, 0, 0)), np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0]]))[0])
    assert pdfs[-1][0] > pdfs[0][0] > 0.5
    assert pdfs[-1][1] < 0.05 * pdfs[-1][0]


def test_splits_fit_hard_edges_better():
    """A window and a slit: bright rectangles on a dim sphere, started from four lobes with and without splits."""

    def radiance(d):
        window = (np.abs(d[:, 0]) < 0.3) & (np.abs(d[:, 1]) < 0.3) & (d[:, 2] > 0.0)
        slit = (np.abs(d[:, 2]) < 0.05) & (d[:, 0] > 0.0)
        return 0.05 + 10.0 * window + 10.0 * slit

    found = []
    for threshold in (0.5, 1e9):
        settings = VmmSettings(10**9, initial_lobes=4, split_threshold=threshold)
        model = learn(np.random.default_rng(10), radiance, 20_000, 4, settings)
        found.append(divergence(radiance, model.field))
    assert found[0] < 0.7 * found[1]


# ---------------------------------------------------------------------------------------------------------------------
# The tree


def constant(d):
    return np.ones(len(d))


def test_leaves_are_cut_by_their_samples():
    model = learn(np.random.default_rng(11), constant, 40_000, 2, VmmSettings(4000))
    field = model.field
    assert 12 < model.region_count < 50
    points = np.random.default_rng(12).uniform(-1, 1, (2000, 3))
    leaf, region = regions(field, points, np.random.default_rng(13).random(2000))
    assert set(leaf) == set(range(model.region_count))
    assert (region >= 0).all()
    # The leaf's pivot is near: cells are a quarter of the box or so.
    assert np.linalg.norm(points - field.pivot[leaf], axis=1).mean() < 0.8


def test_look_ups_blend_over_borders():
    """Regions change gradually with the point: where cells meet both are found, each as often as it is near."""
    model = learn(np.random.default_rng(14), constant, 40_000, 1, VmmSettings(4000))
    field = model.field
    count = 4000
    rng = np.random.default_rng(18)
    for point in rng.uniform(-0.8, 0.8, (8, 3)).astype(np.float32):
        leaf, region = regions(field, np.repeat(point[None], count, 0), rng.random(count))
        # What must come out: the nearest of the leaf's neighbours to points spread over the box of its reach.
        near = point + rng.uniform(-1, 1, (100_000, 3)) * field.reach[leaf[0]]
        candidates = field.neighbors[leaf[0]]
        nearest = candidates[((near[:, None] - field.pivot[candidates][None]) ** 2).sum(2).argmin(1)]
        expected = np.bincount(nearest, minlength=model.region_count) / len(near)
        share = np.bincount(region, minlength=model.region_count) / count
        # Six standard errors of a share.
        assert np.abs(share - expected).max() < 6 * 0.5 / np.sqrt(count)
        assert 2 <= (expected > 0).sum() <= len(candidates)


def test_nothing_is_found_outside_or_before_learning():
    model = VmmModel(BOX, VmmSettings(16_000))
    assert regions(model.field, [(0, 0, 0)], [0.5])[1][0] == -1
    model.update(uniform_records(np.random.default_rng(15), 4000, constant), 4000)
    points = [(0, 0, 0), (2, 0, 0), (0, -1.5, 0), (np.nan, 0, 0), (np.inf, 0, 0), (0, 0, -1e30)]
    leaf, region = regions(model.field, points, np.full(6, 0.3))
    assert list(leaf) == [0, -1, -1, -1, -1, -1]
    assert list(region) == [0, -1, -1, -1, -1, -1]


def test_black_regions_stay_unready():
    model = learn(np.random.default_rng(16), lambda d: np.zeros(len(d)), 20_000, 2)
    assert not model.field.is_ready.any()
    assert (regions(model.field, [(0.3, 0, 0)], [0.5])[1] == -1).all()


def test_an_empty_child_keeps_what_its_parent_knew():
    rng = np.random.default_rng(17)
    model = VmmModel(BOX, VmmSettings(1000))
    model.update(uniform_records(rng, 900, constant), 900)
    assert model.region_count == 1
    model.update(uniform_records(rng, 300, constant, low=(0.8, -1, -1)), 300)
    assert model.region_count == 2
    assert model.field.is_ready.all()
    leaf, region = regions(model.field, [(-0.9, 0, 0), (0.9, 0, 0)], [0.1, 0.1])
    assert leaf[0] != leaf[1] and (region >= 0).all()
    assert np.isfinite(model.field.lobes).all() and np.isfinite(model.field.pivot).all()
    model.update(uniform_records(rng, 300, constant, high=(-0.5, 1, 1)), 300)
    assert model.field.pivot[leaf[0], 0] < -0.5


@pytest.mark.parametrize("flat", [(0,), (1, 2), (0, 1, 2)])
def test_positions_without_extent(flat):
    low, high = np.full(3, -0.5), np.full(3, 0.5)
    for axis in flat:
        low[axis] = high[axis] = 0.1234567
    model = learn(np.random.default_rng(18), constant, 10_000, 3, VmmSettings(2000), low=low, high=high)
    assert (model.region_count == 1) == (len(flat) == 3)
    assert (regions(model.field, [(low + high) / 2], [0.5])[1] >= 0).all()
    used = model.field.node_link[:, 0]
    assert not set(flat) & set(used[used >= 0])


def test_huge_and_distant_coordinates():
    """A sun plus far objects: most samples lie in a cubic metre of a world 1e9 m wide, far from its origin."""
    rng = np.random.default_rng(19)
    model = VmmModel(((-1e9,) * 3, (1e9,) * 3), VmmSettings(2000))
    for _ in range(3):
        directions = uniform_directions(rng, 10_000)
        positions = rng.uniform(0, 1, (10_000, 3)) + (1000.0, 0, 0)
        positions[:50] = rng.uniform(-1e9, 1e9, (50, 3))
        model.update(make_records(positions, directions, 1.0, 0.25 / np.pi, 2e9), 10_000)
    field = model.field
    assert np.isfinite(field.lobes).all() and np.isfinite(field.pivot).all()
    assert model.region_count > 5
    inside = rng.uniform(0, 1, (500, 3)) + (1000.0, 0, 0)
    assert len(set(regions(field, inside, np.zeros(500))[0])) > 4
    assert model.report()["records_outside"] == 0


def test_unusable_records_are_left_out_and_counted():
    rng = np.random.default_rng(20)
    clean = uniform_records(rng, 2000, constant)
    dirty = uniform_records(np.random.default_rng(20), 2000, constant)
    bad = np.arange(0, 900, 100)
    keep = np.ones(2000, bool)
    keep[bad] = False
    dirty.radiance[0] = np.nan
    dirty.radiance[100, 1] = np.inf
    dirty.position[200, 2] = np.nan
    dirty.direction[300] = np.nan
    dirty.direction[400] = 0.0
    dirty.pdf[500] = 0.0
    dirty.pdf[600] = np.nan
    dirty.radiance[700, 2] = -1.0
    dirty.position[800] = 5.0
    fields = []
    for records, rows in ((clean, keep), (dirty, np.ones(2000, bool))):
        kept = type(records)(*(np.ascontiguousarray(column[rows]) for column in records))
        model = VmmModel(BOX)
        model.update(kept, int(rows.sum()))
        fields.append(model.field)
    report = model.report()
    assert report["records_invalid"] == 8 and report["records_outside"] == 1
    assert np.array_equal(fields[0].lobes, fields[1].lobes)


@pytest.mark.parametrize("radiance", [1e38, 1e30])
def test_regions_whose_fit_comes_to_nothing_begin_anew(radiance):
    """Light that is finite, and over its density is not."""
    rng = np.random.default_rng(21)
    model = VmmModel(BOX, PARSIMONIOUS)
    model.update(uniform_records(rng, 2000, constant), 2000)
    good = model.field
    absurd = uniform_records(rng, 2000, constant)
    absurd.radiance[:700] = radiance
    absurd.pdf[:700] = 1e-3
    model.update(absurd, 2000)
    assert good.is_ready.all() and not model.field.is_ready.any() and model.report()["regions_unsound"] == 1
    assert all(np.isfinite(array).all() for array in model.field._asdict().values())
    again = VmmModel.of_state(model.state(), PARSIMONIOUS)
    for learning in (model, again):
        learning.update(uniform_records(np.random.default_rng(22), 2000, constant), 2000)
        assert learning.field.is_ready.all() and np.isfinite(learning.field.lobes).all()


def test_nothing_to_learn_from():
    model = VmmModel(BOX)
    model.update(uniform_records(np.random.default_rng(21), 16, constant), 0)
    assert model.region_count == 1 and not model.field.is_ready.any()
    with pytest.raises(ValueError, match="bounds"):
        VmmModel(((0, 0, np.nan), (1, 1, 1)))


def test_threads_do_not_change_the_field():
    def radiance(d):
        return mixture_density(d, [(0.7, 20.0, (1.0, 0.0, 0.0)), (0.3, 200.0, (0.0, 1.0, 0.0))])

    fields = []
    for threads in (1, 2, 5):
        rng = np.random.default_rng(22)
        model = VmmModel(BOX, VmmSettings(3000))
        with ThreadPoolExecutor(threads) as executor:
            for _ in range(3):
                model.update(uniform_records(rng, 40_000, radiance), 40_000, executor, threads)
        fields.append(model.field)
    for other in fields[1:]:
        for a, b in zip(fields[0], other, strict=True):
            assert np.array_equal(a, b)


def test_a_published_field_does_not_change():
    rng = np.random.default_rng(23)
    model = learn(rng, constant, 8000, 1, VmmSettings(2000))
    before = model.field
    copies = [array.copy() for array in before]
    model.update(uniform_records(rng, 20_000, lambda d: vmf_density(d, (1, 0, 0), 50.0)), 20_000)
    assert model.field is not before
    assert all(np.array_equal(a, b) for a, b in zip(before, copies, strict=True))
