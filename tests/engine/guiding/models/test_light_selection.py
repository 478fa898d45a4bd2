# SPDX-License-Identifier: GPL-3.0-or-later
"""Which lights regions sample: those that bring them light, and the tree's choice where that is as good."""

import numpy as np
import pytest

from engine.guiding.fields.update import make_runner
from engine.guiding.fields.vmm.leaves import find_leaves
from engine.guiding.fields.vmm.regions import RegionTree
from engine.guiding.models.light_selection import LightSelectionModel
from engine.guiding.records.vertices import allocate_vertex_records, as_records

COUNT, CLUSTERS = 4000, 6


def learn(moment_below, moment_above, *, pmf=None, is_possible=None):
    """Probabilities of two regions, below and above x = 0, whose records find so much light by cluster (M_k)."""
    rng = np.random.default_rng(7)
    records = allocate_vertex_records(2 * COUNT)
    records.position[:] = rng.uniform(-1, 1, (2 * COUNT, 3)) * (1.0, 0.1, 0.1)
    records.direction[:] = records.normal[:] = (0.0, 0.0, 1.0)
    for column in (records.radiance, records.pdf, records.distance, records.roughness):
        column[:] = 1.0
    tree = np.full(CLUSTERS, 1.0 / CLUSTERS)
    chosen = tree if pmf is None else np.asarray(pmf)
    cluster = rng.choice(CLUSTERS, 2 * COUNT, p=chosen)
    is_above = records.position[:, 0] > 0.0
    moment = np.where(is_above[:, None], moment_above, moment_below)[np.arange(2 * COUNT), cluster]
    records.light_cluster[:] = cluster
    records.light_pmf[:], records.tree_pmf[:] = chosen[cluster], tree[cluster]
    # A contribution in proportion to 1 / P_k, whose expected square times P_k^2 is the moment.
    records.light_squared[:] = moment / chosen[cluster] ** 2
    regions = RegionTree([[-1, -1, -1], [1, 1, 1]], samples_per_region=int(1.5 * COUNT))
    regions.update(as_records(records), 2 * COUNT, make_runner(None, 1))
    leaf = np.zeros(2 * COUNT, np.int32)
    find_leaves(regions.published, records.position, leaf)
    is_possible = np.ones(CLUSTERS, np.bool_) if is_possible is None else is_possible
    model = LightSelectionModel(is_possible)
    model.update(regions, records, leaf)
    region = np.zeros(2, np.int32)
    find_leaves(regions.published, np.array([[-0.5, 0, 0], [0.5, 0, 0]], np.float32), region)
    assert region[0] != region[1]
    selection = model.selection(regions)
    if len(selection.cumulative) == 0:
        return [None, None]
    probability = np.diff(selection.cumulative, axis=1)
    trees = len(np.atleast_2d(is_possible))
    by_region = probability.reshape(-1, trees, CLUSTERS)[:, 0 if trees == 1 else slice(None)]
    return [by_region[selection.table[r]] if selection.table[r] >= 0 else None for r in region]


def test_each_light_tree_has_probabilities_of_its_own() -> None:
    in_tree = np.arange(CLUSTERS) // 3 == np.arange(2)[:, None]
    below, above = learn([1.0, 0, 0, 4.0, 0, 0], [0, 0, 1.0, 0, 0, 1.0], is_possible=in_tree)
    for region, (first, second) in ((below, (0, 3)), (above, (2, 5))):
        assert region.sum(axis=1) == pytest.approx([1.0, 1.0], abs=1e-5)
        assert (region[~in_tree] == 0.0).all()
        assert region[0, first] > 0.6
        assert region[1, second] > 0.6
        assert region[in_tree].min() > 0.003


def test_each_region_samples_the_lights_it_sees() -> None:
    below, above = learn([1.0, 0, 0, 0, 0, 0], [0, 0, 0, 0, 0, 4.0])
    assert below[0] > 0.7 and above[5] > 0.7
    # None is given up: it may be seen from a corner where no record was.
    assert min(below.min(), above.min()) > 0.003
    assert below.sum() == pytest.approx(1.0, abs=1e-5)


def test_halves_of_a_region_share_what_it_has_found() -> None:
    """Nothing is lost or doubled."""
    rng = np.random.default_rng(3)
    records = allocate_vertex_records(COUNT)
    records.position[:] = rng.uniform(-1, 1, (COUNT, 3))
    records.direction[:] = records.normal[:] = (0.0, 0.0, 1.0)
    for column in (records.radiance, records.pdf, records.distance, records.roughness):
        column[:] = 1.0
    records.light_cluster[:] = 0
    records.light_pmf[:] = records.tree_pmf[:] = records.light_squared[:] = 1.0
    regions = RegionTree([[-1, -1, -1], [1, 1, 1]], samples_per_region=COUNT // 2)
    model = LightSelectionModel(np.ones(CLUSTERS, np.bool_))
    leaf, known, counts = np.zeros(COUNT, np.int32), [0.0], []
    for _ in range(4):
        regions.update(as_records(records), COUNT, make_runner(None, 1))
        find_leaves(regions.published, records.position, leaf)
        model.update(regions, records, leaf)
        known.append(0.8 * known[-1] + COUNT)
        counts.append(regions.region_count)
        assert model.known.sum() == pytest.approx(known[-1]) == model.sums.sum()
    assert counts[-1] > counts[0]


@pytest.mark.parametrize("pmf", [None, [0.5, 0.1, 0.1, 0.1, 0.1, 0.1]])
def test_probabilities_follow_the_roots_of_the_moments(pmf) -> None:
    """Whatever the records were chosen by."""
    below, _ = learn([16.0, 1.0, 0, 0, 0, 0], [0, 0, 0, 0, 0, 1.0], pmf=pmf)
    assert (below[0] - below[3]) / (below[1] - below[3]) == pytest.approx(4.0, rel=0.15)


def test_regions_that_see_all_lights_alike_stay_with_the_tree() -> None:
    assert learn([1.0] * CLUSTERS, [1.0] * CLUSTERS) == [None, None]


def test_nothing_is_learned_in_the_dark() -> None:
    assert learn([0.0] * CLUSTERS, [0.0] * CLUSTERS) == [None, None]


def test_learning_ends_after_updates_in_vain() -> None:
    regions = RegionTree([[-1, -1, -1], [1, 1, 1]], samples_per_region=10)
    model = LightSelectionModel(np.ones(CLUSTERS, np.bool_))
    ended = []
    for _ in range(7):
        assert len(model.selection(regions).cumulative) == 0
        ended.append(model.is_over)
    assert ended == [False] * 5 + [True] * 2
