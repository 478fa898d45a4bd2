# SPDX-License-Identifier: GPL-3.0-or-later
"""The trial of guiding: what it measures, and that the image goes on without guiding where it loses."""

import numpy as np
import pytest

from engine.guiding.policy import trial
from engine.guiding.policy.iterations import iteration_weight
from engine.guiding.policy.rules import RULES
from engine.guiding.policy.sets import make_learner
from engine.guiding.policy.trial import ComparedValues, GuidingTrial, SampleMoments, arms, tried_weight
from engine.render.film import Film
from engine.ris.orca import pixel_weights
from engine.settings import RenderSettings
from engine.state.unit import CURRENT, PLAIN
from tests.helpers.seeded_renders import SEEDS, Z_LIMIT, render, trial_rules, z_score
from tests.helpers.small_scenes import corner_scene

PIXELS = 4000


def compared(plain_spread, guided_spread, *, cost_ratio=1.0, samples=8, outlier=0.0):
    """A trial of pixels whose samples have these standard deviations, in three channels."""
    rng = np.random.default_rng(11)
    tried = GuidingTrial(PIXELS)
    pixels = np.arange(PIXELS)
    for is_guided, spread in ((False, plain_spread), (True, guided_spread)):
        values = 1.0 + spread * rng.normal(size=(samples, PIXELS, 3))
        values[0, 0] += outlier * is_guided
        # In two units, with room for more pixels than they have.
        for half in (pixels[:1500], pixels[1500:]):
            sums = np.zeros((2, PIXELS, 3), np.float32)
            sums[0, : len(half)] = values[:, half].sum(0)
            sums[1, : len(half)] = (values[:, half] ** 2).sum(0)
            tried.add(half, *sums, samples, is_guided)
            tried.add_cost((cost_ratio if is_guided else 1.0) * len(half) * samples, len(half) * samples, is_guided)
    return tried.efficiency(np.ones(PIXELS, np.float32))


def test_efficiency_is_that_of_variance_times_cost():
    assert compared(1.0, 0.5) == pytest.approx(4.0, rel=0.05)
    assert compared(1.0, 0.5, cost_ratio=2.0) == pytest.approx(2.0, rel=0.05)
    assert compared(1.0, 1.0, cost_ratio=1.6) == pytest.approx(1 / 1.6, rel=0.05)


def test_single_bright_samples_do_not_decide():
    assert compared(1.0, 0.5, outlier=1e4) == pytest.approx(4.0 / 1.05, rel=0.3)


def test_nothing_compared_is_not_a_number():
    tried = GuidingTrial(PIXELS)
    assert np.isnan(tried.efficiency(np.ones(PIXELS, np.float32)))
    tried.add(np.arange(10), np.ones((10, 3), np.float32), np.ones((10, 3), np.float32), 4, True)
    tried.add_cost(1.0, 40, True)
    assert np.isnan(tried.efficiency(np.ones(PIXELS, np.float32)))


def test_the_arm_whose_variance_is_no_number_loses():
    """A black picture, and one whose squares are beyond float32."""
    for square, is_lost in ((0.0, True), (np.inf, True), (4.0, False)):
        tried = GuidingTrial(PIXELS)
        for is_challenger in (False, True):
            squares = np.full((10, 3), square if is_challenger else 8.0, np.float32)
            tried.add(np.arange(10), np.zeros((10, 3), np.float32), squares, 4, is_challenger)
            tried.add_cost(1.0, 40, is_challenger)
        assert (tried.efficiency(np.ones(PIXELS, np.float32)) == 0.0) == is_lost


def test_moments_are_those_of_all_samples_together():
    rng = np.random.default_rng(5)
    values = rng.exponential(size=(12, PIXELS, 3)) + 30.0
    values[:, 1] *= 1e4
    moments = SampleMoments(PIXELS)
    assert np.isnan(moments.variance()).all()
    chosen = np.arange(PIXELS - 1)  # the last is in no unit
    for first, last in ((0, 1), (1, 5), (5, 12)):
        some = values[first:last, chosen].astype(np.float32)
        moments.add(chosen, some.sum(0), (some**2).sum(0), last - first)
        assert np.isfinite(moments.variance()[chosen]).all() == (last > 1)
    expected = values.var(axis=0, ddof=1).mean(axis=1)[chosen]
    assert moments.variance()[chosen] == pytest.approx(expected, rel=1e-2)
    assert np.isnan(moments.variance()[-1])


def test_unguided_samples_from_before_count():
    """Where one unguided sample in a thousand is bright, four a pixel hide the variance of most pixels."""
    rng = np.random.default_rng(2)
    pixels = np.arange(400)

    def take(add, chance, rounds):
        for _ in range(rounds):
            values = rng.binomial(1, chance, size=(4, len(pixels), 3)) / chance
            add(pixels, values.sum(0).astype(np.float32), (values**2).sum(0).astype(np.float32), 4)

    found = {False: [], True: []}
    for _ in range(40):
        for is_pooled, efficiencies in found.items():
            before = SampleMoments(len(pixels))
            take(before.add, 0.001, 20 * is_pooled)
            tried = GuidingTrial(len(pixels), before if is_pooled else None)
            take(lambda *sums, tried=tried: tried.add(*sums, False), 0.001, 1)
            take(lambda *sums, tried=tried: tried.add(*sums, True), 0.1, 3)
            for is_guided in (False, True):
                tried.add_cost(1.0, 1, is_guided)
            efficiencies.append(tried.efficiency(np.ones(len(pixels), np.float32)))
    truth = 999.0 / 9.0
    assert np.median(found[True]) == pytest.approx(truth, rel=0.15)
    assert np.median(found[False]) < 0.7 * truth


@pytest.mark.parametrize("iteration", range(8))
@pytest.mark.parametrize("count", [1, 3, 5, 16])
def test_arms_hold_every_sample_once(iteration, count):
    for is_tried in (False, True):
        pieces = arms(iteration, 7, count, is_tried=is_tried)
        samples = [sample for first, size, _ in pieces for sample in range(first, first + size)]
        assert samples == list(range(7, 7 + count))
        assert pieces[0][2] == CURRENT, "the guided part comes first"
        is_split = is_tried and iteration in RULES.least_efficiency and count >= 4
        assert len(pieces) == (2 if is_split else 1)
        assert not is_split or pieces[1][1] >= 2, "a variance takes two"


@pytest.mark.parametrize("method", ["VMM", "VMM_RIS"])
def test_guiding_ends_where_it_does_not_pay(method):
    """Two sunlit planes: light sampling finds all there is, and half of the directions come from the guide."""
    samples = 70
    shared = {"scene": lambda: corner_scene((32, 28)), "samples": samples}
    tried = [render(method, seed, learn_guiding_probability=False, **shared) for seed in range(SEEDS)]
    for result in tried:
        assert 0.0 < result.report.guiding.efficiency < 1.0
        assert 8 <= result.report.guiding.stopped_at < samples
        assert any("did not pay" in line for line in result.report.guiding.lines)
    plain = [render("OFF", seed, **shared) for seed in range(SEEDS)]
    means = [np.array([r.passes["Combined"][..., :3].mean() for r in results]) for results in (tried, plain)]
    assert z_score(*means) < Z_LIMIT
    assert z_score(means[0] * 1.05, means[1]) > Z_LIMIT


def test_guiding_goes_on_without_a_trial_and_where_it_wins():
    untried = render("VMM", 1, samples=31, guiding_trial=False).report.guiding
    assert untried.stopped_at == 0 and np.isnan(untried.efficiency)
    won = render("VMM", 1, samples=31, rules=trial_rules(0.0, 0.0)).report.guiding
    assert won.stopped_at == 0 and won.efficiency > 0.0
    assert won.record_count > 0


def test_the_trial_does_not_depend_on_threads():
    shared = {"scene": lambda: corner_scene((40, 40)), "samples": 70, "learn_guiding_probability": False}
    one, two = (render("VMM", 3, threads=threads, **shared) for threads in (1, 2))
    assert one.report.guiding.stopped_at == two.report.guiding.stopped_at > 0
    assert one.report.guiding.efficiency == two.report.guiding.efficiency
    assert np.array_equal(one.passes["Combined"], two.passes["Combined"])


def test_little_that_is_left_gives_no_benefit_of_the_doubt():
    """No later part of a short render could pay for what a trial costs; a long one waits."""
    assert trial.least_efficiency(3, 16, 1000.0) == RULES.least_efficiency[3] < 1.0
    assert trial.least_efficiency(3, 16, 16.0) == RULES.least_of_short > 1.0
    assert trial.least_efficiency(6, 64, 0.0) == max(RULES.least_efficiency[6], RULES.least_of_short)


def test_a_part_of_the_pixels_gets_the_benefit_of_the_doubt_once():
    """It knows little after eight samples, and costs little; after sixteen it is as any trial of a short render."""
    assert trial.least_efficiency(2, 8, 24.0, is_part=True) == RULES.least_of_first_part < RULES.least_of_short
    assert trial.least_efficiency(2, 8, 24.0) == RULES.least_of_short
    assert trial.least_efficiency(3, 16, 16.0, is_part=True) == RULES.least_of_short
    assert trial.least_efficiency(2, 8, 100.0, is_part=True) == RULES.least_efficiency[2]


def test_a_part_of_the_pixels_goes_on_being_tried_where_that_costs_nothing():
    """In a render that is 16 times as long; scenes with media are told by what regions promise."""
    assert trial.least_efficiency(2, 8, 200.0, is_part=True) == RULES.least_of_long_part < RULES.least_efficiency[2]
    assert trial.least_efficiency(3, 16, 400.0, is_part=True) == RULES.least_of_long_part
    assert trial.least_efficiency(2, 8, 200.0) == RULES.least_efficiency[2]
    assert trial.least_efficiency(2, 8, 200.0, is_part=True, is_cautious=True) == RULES.least_efficiency[2]


@pytest.mark.parametrize("asked", [{"guiding_trial": False}, {"sample_weighting": "UNIFORM"}])
def test_where_nothing_is_compared_or_asked_for_weights_go_by_the_samples_seen(asked):
    settings = RenderSettings(guiding_method="VMM", samples=64, **asked)
    learner = make_learner(settings, 1, 100)
    for first in (0, 1, 4, 32):
        assert learner.weight(first, CURRENT) == iteration_weight(first, settings)
        assert learner.weight(first, PLAIN) == 0.5 * iteration_weight(first, settings)
    learner.close()


def test_unguided_samples_count_alike():
    """Where guiding is given up little is lost: all but the first weigh one before, during and after the trial."""
    learner = make_learner(RenderSettings(guiding_method="VMM", samples=64), 1, 100)
    assert [learner.weight(first, arm) for first in (1, 4, 32) for arm in (CURRENT, PLAIN)] == [1.0] * 6
    learner.close()
    assert [tried_weight(first, is_guided=False) for first in (0, 4, 8)] == [0.5, 1.0, 1.0]
    assert [tried_weight(first, is_guided=True) for first in (1, 4, 8)] == [1.0, 2.0, 2.0]


def test_a_pixel_s_weight_says_what_was_guided(monkeypatch):
    """1 of 32 samples is unguided, 3 are guided by what it has taught, then 2 + 6 guided and 2 + 2 not, to compare, and
    the last 16 are guided: nobody would go by what these say."""
    found = []

    def merged(film, pixels, tile, weight=1.0, merge=Film.merge):
        merge(film, pixels, tile, weight)
        found.append(film)

    monkeypatch.setattr(Film, "merge", merged)
    render("VMM", 1, samples=32, rules=trial_rules(0.0, 1e9))
    expected = 0.5 + 3.0 + (2.0 * 2.0 + 2.0) + (2.0 * 6.0 + 2.0) + 2.0 * 16.0
    np.testing.assert_array_equal(found[-1].sums.weight, expected)


def test_values_to_compare_by_are_means_of_weighted_samples():
    rng = np.random.default_rng(8)
    values, image = rng.random((5, 12, 3)).astype(np.float32), ComparedValues(12)
    for some, pixels, weight in ((slice(0, 1), slice(0, 12), 0.125), (slice(1, 5), slice(0, 6), 0.5)):
        image.add(np.arange(12)[pixels], values[some, pixels].sum(0), len(values[some]), weight)
    expected = values[0].astype(np.float64)
    expected[:6] = (0.125 * values[0, :6] + 0.5 * values[1:, :6].sum(0)) / (0.125 + 4 * 0.5)
    np.testing.assert_allclose(image.weights((3, 4)), pixel_weights(expected.reshape(3, 4, 3)), rtol=1e-4)
