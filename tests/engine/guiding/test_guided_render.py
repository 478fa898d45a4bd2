# SPDX-License-Identifier: GPL-3.0-or-later
"""Guided renders: the same mean as unguided ones whatever predicts, the same image for any thread count."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from engine.guiding.policy.iterations import iteration_lengths, iteration_weight
from engine.guiding.policy.rules import RULES
from engine.guiding.records.vertices import VERTEX_WIDTH, allocate_log
from engine.ris.orca import (
    FLOOR,
    LEAST_RETURN,
    MIN_ESTIMATES,
    CandidateCosts,
    candidate_count,
    least_count,
    make_allocation,
    mean_by_region,
    pixel_weights,
)
from engine.ris.resample import product_target, resample
from engine.ris.rotation import rotated
from engine.settings import MAX_CANDIDATES, RenderSettings
from tests.helpers.seeded_renders import SEEDS, Z_LIMIT, render, z_score
from tests.helpers.small_scenes import corner_scene, pit_scene

pytestmark = pytest.mark.estimator

METHODS = ("VMM", "VMM_RIS", "TABLE_RIS")


def image_mean(*arguments, **settings):
    """Mean of all pixels of `render`."""
    return render(*arguments, **settings).passes["Combined"][..., :3].mean()


def means(method, **settings):
    """Image mean by seed."""
    return np.array([image_mean(method, seed, **settings) for seed in range(SEEDS)])


@pytest.fixture(scope="module")
def unguided():
    return means("OFF")


def test_clamping_takes_no_more_from_light_samples_that_are_taken_seldom(monkeypatch):
    """A sample taken with probability q counts 1 / q times; the limit is on the sample, not on what it counts for.

    Here the limits bite: at 0.3 of the samples half of the light was lost when it was the other way round.
    """
    from engine.guiding.models.light_share import LightShareModel

    def clamped(share):
        def update(model, vmm, records, leaf, *, variance, ray_count):
            model.share = np.full(vmm.region_count, share, np.float32)

        monkeypatch.setattr(LightShareModel, "update", update)
        return means("VMM", scene=pit_scene, samples=31, clamp_indirect=0.3, clamp_direct=1.0, guiding_trial=False)

    always, seldom = clamped(1.0), clamped(0.3)
    unclamped = means("VMM", scene=pit_scene, samples=31, guiding_trial=False)
    assert always.mean() < 0.97 * unclamped.mean()
    assert z_score(always, seldom) < Z_LIMIT
    assert seldom.mean() == pytest.approx(always.mean(), rel=0.02)


@pytest.mark.parametrize("method", METHODS)
def test_guiding_leaves_the_mean_unchanged(method, unguided):
    guided = means(method)
    assert z_score(guided, unguided) < Z_LIMIT
    # The test can see a bias of 5%.
    assert z_score(guided * 1.05, unguided) > Z_LIMIT


def test_roulette_by_what_was_learned_leaves_the_mean_unchanged():
    """Paths that go on for longer than unguided ones would: means against renders without any roulette."""

    longest = {"samples": 63, "max_bounces": 12, "diffuse_bounces": 12, "guiding_trial": False}
    guided = np.array([image_mean("VMM", seed, scene=pit_scene, **longest) for seed in range(6)])
    longest["use_russian_roulette"] = False
    plain = np.array([image_mean("OFF", seed, scene=pit_scene, **longest) for seed in range(6)])
    assert z_score(guided, plain) < Z_LIMIT
    # The test can see a bias of 2%.
    assert z_score(guided * 1.02, plain) > Z_LIMIT


def test_guided_vertices_and_candidates_are_reported():
    report = render("VMM_RIS", 1, candidate_count=4).report.guiding
    assert "4.00 candidates a vertex" in report.lines[0]
    assert report.candidates_per_vertex == pytest.approx(4.0)
    assert report.region_count >= 1
    assert report.record_count > 1000


def test_passes_show_candidates_and_benefit():
    def passes_of(**settings):
        passes = render(
            "VMM_RIS", 2, scene=pit_scene, passes=("Combined", "Candidate Count", "Guiding Benefit"), samples=31,
            max_bounces=12, diffuse_bounces=12, candidate_count=4, guiding_trial=False, sample_weighting="UNIFORM",
            **settings,
        ).passes
        return passes["Candidate Count"], passes["Guiding Benefit"]

    everywhere, _ = passes_of(learn_guiding_probability=False)
    # The first iteration of one sample knows nothing.
    np.testing.assert_allclose(everywhere, 4.0 * 30 / 31, atol=0.2)
    candidates, benefit = passes_of()
    assert candidates.min() >= 0.0
    assert candidates.max() <= everywhere.max()
    assert np.isfinite(benefit).all()
    assert benefit.min() >= 1.0
    assert benefit.max() > 1.02
    # What is guided most is what benefits.
    order = np.argsort(candidates.ravel())
    assert benefit.ravel()[order[-100:]].mean() > benefit.ravel()[order[:100]].mean()


@pytest.mark.parametrize("method", METHODS)
def test_the_image_does_not_depend_on_threads(method):
    scene = partial(corner_scene, (48, 40))
    one, two = (render(method, 3, scene=scene, threads=threads).passes["Combined"] for threads in (1, 2))
    assert np.array_equal(one, two)


@pytest.mark.slow
def test_neural_resampling_leaves_the_mean_unchanged(unguided):
    guided = means("NEURAL_RIS", deterministic=True, candidate_allocation="FIXED", candidate_count=4)
    assert z_score(guided, unguided) < Z_LIMIT
    report = render("NEURAL_RIS", 1, deterministic=True, candidate_allocation="FIXED").report
    assert report.guiding.snapshot_count > 0
    assert not [notice for notice in report.notices if "Guiding" in notice.subject]


@pytest.mark.parametrize("kind", ["good", "random", "constant", "zero", "nan", "inverted", "denormal"])
def test_resampling_is_unbiased_for_any_target(kind):
    """Mean of f / p over many draws against the sum of f, for a discrete domain; Z-test at four standard errors."""
    rng = np.random.default_rng(7)
    values = np.array([0.0, 1.0, 2.0, 10.0, 0.5], np.float32)
    source = np.array([0.3, 0.2, 0.2, 0.1, 0.2], np.float32)
    targets = {
        "good": values,
        "random": rng.random(5).astype(np.float32),
        "constant": np.ones(5, np.float32),
        "zero": np.zeros(5, np.float32),
        "nan": np.full(5, np.nan, np.float32),
        "denormal": np.full(5, 1e-42, np.float32),
        "inverted": 1.0 / (values + np.float32(0.01)),
    }[kind]
    radiance, f_cos, throughput = targets[:, None].copy(), np.ones((5, 1), np.float32), np.ones((1, 1), np.float32)
    target = np.array(
        [product_target(throughput, 0, f_cos, radiance, row, (0,), False) for row in range(5)], np.float32
    )
    draw_count, count = 20000, 4
    drawn = rng.choice(5, size=(draw_count, count), p=source.astype(float) / source.sum(dtype=float))
    total = np.zeros(draw_count)
    for k in range(draw_count):
        chosen = drawn[k]
        row, weight = resample(
            target[chosen], source[chosen], (values[chosen] > 0.0).astype(np.uint8), 0, count, np.float32(0.9),
            np.float32(rng.random()),
        )
        total[k] = values[chosen[row]] * weight if row >= 0 else 0.0
    error = total.std() / np.sqrt(draw_count)
    assert abs(total.mean() - values.sum()) < 4.0 * error
    # Defensive resampling bounds the second moment, whatever the target: that of source sampling over 1 - alpha.
    plain = (values[drawn] / source[drawn])[:, 0]
    assert (total**2).mean() < 1.1 * (plain**2).mean() / (1.0 - 0.9)
    if kind == "good":
        assert total.std() < 0.6 * plain.std()


def test_iterations_grow_and_hold_every_sample():
    assert iteration_lengths(1) == [1]
    lengths = iteration_lengths(100)
    assert sum(lengths) == 100
    assert lengths == [1, 3, 4, 8, 16, 16, 16, 16, 20], "the last four are not worth learning for"
    assert iteration_lengths(104)[-1] == 8
    assert [sum(iteration_lengths(samples)) for samples in range(200)] == list(range(200))
    assert max(iteration_lengths(4096)) == RULES.longest_iteration
    guided = RenderSettings(guiding_method="VMM")
    weights = [iteration_weight(first, guided) for first in (0, 1, 15, 31, 1000)]
    assert weights == sorted(weights) and weights[-1] == 1.0
    assert iteration_weight(0, replace(guided, sample_weighting="UNIFORM")) == 1.0
    cached = RenderSettings(guiding_method="OFF", radiance_cache="FAST")
    np.testing.assert_allclose([iteration_weight(first, cached) for first in (0, 1, 15)], np.sqrt(weights[:3]))


def test_allocation_follows_the_fixed_point():
    costs = CandidateCosts(per_candidate=0.25 / LEAST_RETURN, per_vertex=0.0, per_source_sample=0.0)
    allocation = make_allocation(
        np.array([4.0, -1.0, np.nan, 1e9, 0.01], np.float32), ray_count=5.0, variance=2.0, costs=costs
    )

    def mean_count(leaf):
        numbers = (np.arange(1000, dtype=np.float32) + 0.5) / 1000
        return np.mean([candidate_count(allocation, leaf, np.float32(1.0), True, u) for u in numbers])

    # Eq. (13): sqrt(4 * 5 / (2 * 0.25)) candidates.
    assert mean_count(0) == pytest.approx(np.sqrt(40.0), abs=0.01)
    for leaf in (1, 2, 4, -1):
        assert mean_count(leaf) == pytest.approx(float(FLOOR), abs=0.01)
    assert mean_count(3) == MAX_CANDIDATES


def test_paths_that_are_not_recorded_are_resampled_for_a_reason_only():
    allocation = make_allocation(
        np.array([-1.0, 1e9], np.float32), ray_count=5.0, variance=2.0, costs=CandidateCosts()
    )
    numbers = (np.arange(1000, dtype=np.float32) + 0.5) / 1000

    def mean_count(leaf, is_recorded):
        return np.mean([candidate_count(allocation, leaf, np.float32(1.0), is_recorded, u) for u in numbers])

    assert mean_count(0, False) == 1.0
    assert mean_count(0, True) == pytest.approx(float(FLOOR), abs=0.01)
    assert mean_count(1, False) == mean_count(1, True) == MAX_CANDIDATES


@pytest.mark.parametrize("costs", [(0.2, 0.16, 0.22), (0.1, 1.0, 0.1), (0.5, 0.1, 0.3), (0.3, 0.0, 1.0)])
def test_resampling_begins_where_it_saves_more_than_it_costs(costs):
    costs = CandidateCosts(*costs)
    counts = np.linspace(1.001, 20.0, 20001)
    # A variance delta for which `count` is the optimum of Eq. (13), in units in which a candidate's cost is K0.
    saved = costs.per_candidate * counts**2 * (1.0 - 1.0 / counts)
    spent = counts * costs.per_candidate + costs.per_vertex - costs.per_source_sample
    pays = counts[saved > spent]
    assert least_count(costs) == pytest.approx(max(pays.min(), 1.0), abs=2e-3)


def test_candidates_of_a_vertex_are_uniform_each_and_spread_together():
    cells = 64
    numbers = (np.arange(cells, dtype=np.float32) + 0.5) / cells
    moved = np.array([[rotated(u, u, u, u, j) for u in numbers] for j in range(MAX_CANDIDATES)])
    assert moved.min() >= 0.0 and moved.max() < 1.0
    for j in range(MAX_CANDIDATES):
        for axis in range(4):
            # One in each cell, but for rounding at their borders.
            assert np.bincount((moved[j, :, axis] * cells).astype(int), minlength=cells).max() <= 2
            assert np.ptp(np.sort(moved[j, :, axis]) - numbers) < 1e-4
    # Eight independent numbers leave a gap of this size once in a hundred times.
    for axis in range(4):
        gaps = np.diff(np.sort(moved[:8, 0, axis]))
        assert gaps.max() < 0.35


def test_one_outlier_does_not_decide_a_region():
    leaf = np.zeros(1000, np.int32)
    estimate = np.ones(1000, np.float32)
    estimate[0] = 1e9
    # The outlier keeps a share of the sum, not all of it, and without it the mean is exact.
    assert mean_by_region(leaf, estimate, 2)[0] < 0.11 * 1e9 / 1000
    assert mean_by_region(leaf[1:], estimate[1:], 2)[0] == pytest.approx(1.0)
    assert np.isnan(mean_by_region(leaf, estimate, 2)[1])
    assert np.isnan(mean_by_region(leaf[: MIN_ESTIMATES - 1], estimate[: MIN_ESTIMATES - 1], 1)[0])


def test_pixel_weights_do_not_depend_on_the_unit_of_light():
    mean = np.random.default_rng(1).random((12, 9, 3)).astype(np.float32)
    dim, bright = (pixel_weights(mean * scale) for scale in (1.0, 100.0))
    np.testing.assert_allclose(dim, bright * 1e4, rtol=1e-4)


def test_an_unguided_batch_keeps_no_vertices():
    assert allocate_log(64, use_vertices=False).real.shape == (1, VERTEX_WIDTH)


def test_small_pictures_drop_no_records() -> None:
    """Sixteen samples of a thousand pixels leave more records than a unit has room for: fewer paths are recorded."""
    report = render("VMM", 1, scene=corner_scene, samples=63, guiding_trial=False).report
    assert report.guiding.record_count > 50_000 and report.record_drop_count == 0
