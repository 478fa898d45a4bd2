# SPDX-License-Identifier: GPL-3.0-or-later
"""What is chosen by region: surfaces and collisions with media apart, though they share the mixtures."""

import numpy as np
import pytest

from engine.guiding.models.regions import RegionModels
from engine.guiding.records.vertices import VertexRecords
from tests.helpers.learned_fields import random_records

#: Of the directions, where what is guided well is guided to.
PEAK = 0.1


def records_of_both(seed: int) -> VertexRecords:
    """Records of which every second is a collision. The guide is right at those and misses on surfaces."""
    rng = np.random.default_rng(seed)
    records = random_records(seed)
    collides = np.arange(len(records.pdf)) % 2 == 1
    records.program[collides] = -1
    even, peaked = 0.25 / np.pi, 0.25 / np.pi / PEAK
    records.bsdf_pdf[:] = even
    guided = rng.random(len(collides)) < 0.5
    in_peak = np.where(guided & collides, True, rng.random(len(collides)) < PEAK)
    # The guide of surfaces leads to where the light is not.
    is_lit = np.where(collides, in_peak, in_peak & ~guided)
    records.guide_pdf[:] = np.where(collides == is_lit, peaked, 0.0)
    records.pdf[:] = 0.5 * (records.guide_pdf + even)
    records.contribution_squared[:] = np.where(is_lit, 1.0 / records.pdf**2, 0.0)
    records.benefit[:] = np.where(collides, 5.0, 1.0)
    return records


def learned(updates=2) -> RegionModels:
    regions = None
    for seed in range(updates):
        records = records_of_both(seed)
        if regions is None:
            regions = RegionModels.of_records(records, len(records.pdf), 0.5)
        regions.fit(records, len(records.pdf))
        regions.add_deltas(records, len(records.pdf))
        regions.learn_shares(records, len(records.pdf), variance=1e-6, ray_count=1.0, was_guided=True)
    assert regions is not None
    return regions


def test_surfaces_and_collisions_are_guided_each_as_it_pays():
    regions = learned()
    count = regions.mixture.region_count
    probability = regions.probability(is_learned=True)
    assert probability.shape == (2 * count,)
    assert probability[:count].max() <= 0.1
    assert probability[count:].min() >= 0.6
    np.testing.assert_array_equal(regions.probability(is_learned=False), np.full(2 * count, 0.5, np.float32))


def test_candidates_are_counted_apart():
    deltas = learned().variance_deltas()
    count = len(deltas) // 2
    np.testing.assert_allclose(deltas[:count], 1.0)
    np.testing.assert_allclose(deltas[count:], 5.0)


def test_without_media_there_are_no_rows_for_them():
    records = random_records(0)
    regions = RegionModels.of_records(records, len(records.pdf), 0.5)
    regions.fit(records, len(records.pdf))
    regions.add_deltas(records, len(records.pdf))
    regions.learn_shares(records, len(records.pdf), variance=1.0, ray_count=1.0, was_guided=True)
    assert not regions.knows_media
    assert len(regions.probability(is_learned=True)) == regions.mixture.region_count == len(regions.variance_deltas())


def test_a_state_brings_the_choices_back():
    regions = learned()
    again = RegionModels.of_state(regions.state(), 0.5)
    assert again.knows_media
    np.testing.assert_array_equal(again.probability(is_learned=True), regions.probability(is_learned=True))
    np.testing.assert_allclose(again.variance_deltas(), regions.variance_deltas())


def test_media_that_are_met_later_begin_with_the_probability_of_the_settings():
    records = random_records(3)
    regions = RegionModels.of_records(records, len(records.pdf), 0.5)
    for seed in (3, 4):
        records = random_records(seed)
        records.program[:] = 0 if seed == 3 else -1
        records.guide_pdf[:] = np.nan
        regions.fit(records, len(records.pdf))
        regions.learn_shares(records, len(records.pdf), variance=1.0, ray_count=1.0, was_guided=False)
    count = regions.mixture.region_count
    assert regions.probability(is_learned=True)[count:] == pytest.approx(0.5)
