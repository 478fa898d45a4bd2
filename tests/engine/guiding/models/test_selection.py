# SPDX-License-Identifier: GPL-3.0-or-later
"""The learned guiding probability: what it is estimated from, and where the guide is left alone."""

import numpy as np
import pytest

from engine.guiding.fields.vmm.leaves import find_leaves
from engine.guiding.fields.vmm.model import VmmModel, VmmSettings
from engine.guiding.models.selection import PROBABILITIES, SelectionModel
from engine.guiding.records.vertices import allocate_vertex_records, as_records

COUNT = 20_000
#: A narrow peak on a low ground, over a hundred directions.
INTEGRAND = np.full(100, 0.2)
INTEGRAND[40:45] = 10.0
EVEN = np.full(100, 0.01)


def draw(rng, integrand, guide_pdf, bsdf_pdf, probability, count):
    """Squared contributions and the densities that belong to them."""
    source = probability * guide_pdf + (1 - probability) * bsdf_pdf
    x = rng.choice(len(integrand), count, p=source / source.sum())
    return (integrand[x] / source[x]) ** 2, guide_pdf[x], bsdf_pdf[x], source[x]


def leaves(vmm, records):
    """Region of every record."""
    leaf = np.zeros(len(records.position), np.int32)
    find_leaves(vmm.field, records.position, leaf)
    return leaf


def learn(behaviours, **update):
    """A model of two cells, below and above x = 0, that sees records of the two (integrand, guide, BSDF)."""
    rng = np.random.default_rng(5)
    records = allocate_vertex_records(2 * COUNT)
    records.position[:] = rng.uniform(-1, 1, (2 * COUNT, 3)) * (1.0, 0.1, 0.1)
    records.position[:, 0] = np.abs(records.position[:, 0]) * np.repeat((-1, 1), COUNT)
    records.direction[:] = (0.0, 0.0, 1.0)
    records.normal[:] = (0.0, 0.0, 1.0)
    records.radiance[:] = 1.0
    records.distance[:] = 1.0
    for half, (integrand, guide_pdf, bsdf_pdf) in enumerate(behaviours):
        rows = slice(half * COUNT, (half + 1) * COUNT)
        columns = draw(rng, integrand, guide_pdf, bsdf_pdf, 0.5, COUNT)
        for name, column in zip(("contribution_squared", "guide_pdf", "bsdf_pdf", "pdf"), columns, strict=True):
            getattr(records, name)[rows] = column
    vmm = VmmModel([[-1, -1, -1], [1, 1, 1]], VmmSettings(int(1.5 * COUNT)))
    vmm.update(as_records(records), 2 * COUNT)
    assert vmm.region_count == 2
    model = SelectionModel(0.5)
    model.update(vmm, records, leaves(vmm, records), **{"variance": 1e-6, "ray_count": 1.0, **update})
    leaf = np.zeros(2, np.int32)
    find_leaves(vmm.field, np.array([[-0.5, 0, 0], [0.5, 0, 0]], np.float32), leaf)
    return model, model.probability[leaf], leaf


def test_regions_promise_what_they_expect_to_save():
    peak = INTEGRAND / INTEGRAND.sum()
    assert SelectionModel(0.5).promise == 1.0
    useless, *_ = learn([(INTEGRAND, EVEN, peak), (INTEGRAND, EVEN, peak)])
    assert useless.promise == 1.0
    half, *_ = learn([(INTEGRAND, peak, EVEN), (INTEGRAND, EVEN, peak)])
    both, *_ = learn([(INTEGRAND, peak, EVEN), (INTEGRAND, peak, EVEN)])
    assert 2.0 < half.promise < both.promise
    # Costs decide where to guide, and what is not guided saves nothing.
    costly, *_ = learn([(INTEGRAND, peak, EVEN), (INTEGRAND, peak, EVEN)], variance=1e9)
    assert costly.promise == 1.0


def test_each_region_goes_by_the_better_of_guide_and_bsdf():
    peak = INTEGRAND / INTEGRAND.sum()
    _, chosen, _ = learn([(INTEGRAND, peak, EVEN), (INTEGRAND, EVEN, peak)])
    assert chosen[0] == PROBABILITIES[-1]
    assert chosen[1] == 0.0


def test_sums_estimate_the_second_moment_under_every_probability():
    guide = np.roll(INTEGRAND, 2) + 1.0
    guide /= guide.sum()
    model, chosen, leaf = learn([(INTEGRAND, guide, EVEN), (INTEGRAND, guide, EVEN)])
    exact = np.array([(INTEGRAND**2 / (p * guide + (1 - p) * EVEN)).sum() for p in PROBABILITIES])
    for region in leaf:
        estimate = model.sums[region, :-2] / model.sums[region, -1]
        # 20,000 records of bounded contributions: the standard error is below half a percent.
        np.testing.assert_allclose(estimate, exact, rtol=0.03)
    assert chosen[0] == chosen[1] == PROBABILITIES[exact.argmin()]


@pytest.mark.parametrize(("variance", "is_guided"), [(1e-6, True), (1e9, False)])
def test_guiding_has_to_save_what_it_costs(variance, is_guided):
    peak = INTEGRAND / INTEGRAND.sum()
    _, chosen, _ = learn([(INTEGRAND, peak, EVEN)] * 2, variance=variance)
    assert (chosen > 0).all() == is_guided


def test_nothing_is_concluded_from_vertices_without_a_guide():
    rng = np.random.default_rng(6)
    records = allocate_vertex_records(1000)
    records.position[:] = rng.uniform(-1, 1, (1000, 3))
    records.direction[:] = records.normal[:] = (0.0, 0.0, 1.0)
    for column in (records.radiance, records.pdf, records.distance):
        column[:] = 1.0
    records.contribution_squared[:] = 1.0
    records.guide_pdf[:] = records.bsdf_pdf[:] = np.nan
    vmm = VmmModel([[-1, -1, -1], [1, 1, 1]])
    vmm.update(as_records(records), 1000)
    model = SelectionModel(0.4)
    model.update(vmm, records, leaves(vmm, records), variance=1.0, ray_count=1.0)
    assert (model.probability == np.float32(0.4)).all()
