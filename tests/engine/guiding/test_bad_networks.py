# SPDX-License-Identifier: GPL-3.0-or-later
"""Whole renders by networks that know nothing: the same mean, and little more variance than without them."""

from dataclasses import replace

import numpy as np
import pytest

from engine.guiding.models.predictors import PREDICTORS, Predictor
from engine.guiding.neural.models import network_predictor
from engine.guiding.policy.rules import Rules
from engine.guiding.policy.sets import make_learner
from engine.methods import METHODS
from engine.settings import RenderSettings
from tests.helpers.seeded_renders import Z_LIMIT, render, z_score
from tests.helpers.small_scenes import pit_scene
from tests.helpers.untrained_networks import BadNetwork, ask, guess

pytestmark = pytest.mark.estimator

SEEDS = 6
#: Most variance over that of source sampling, which `VMM` is; medians over seeds, since a single bright sample doubles
#: that of a render (inverted: 1.08 to 1.29 in sixteen others, 1.15 on average).
MOST_VARIANCE = 1.25


def mean_and_variance(method, seed):
    passes = render(
        method, seed, scene=pit_scene, passes=("Combined", "Variance"), samples=63, max_bounces=12, diffuse_bounces=12,
        guiding_trial=False, learn_guiding_probability=False, sample_weighting="UNIFORM", threads=1,
    ).passes
    return passes["Combined"][..., :3].mean(), passes["Variance"].mean()


@pytest.fixture(scope="module")
def source():
    """Means and variances of source sampling by seed."""
    return np.array([mean_and_variance("VMM", seed) for seed in range(SEEDS)]).T


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["constant", "zero", "NaN", "random", "inverted"])
def test_bad_networks_change_no_mean_and_cost_little_variance(kind, source, monkeypatch):
    ask(BadNetwork(kind), monkeypatch)
    means, variances = np.array([mean_and_variance("NEURAL_RIS", 100 + seed) for seed in range(SEEDS)]).T
    assert z_score(means, source[0]) < Z_LIMIT
    # The test can see a bias of 2%.
    assert z_score(1.02 * means, source[0]) > Z_LIMIT
    assert np.median(variances) < MOST_VARIANCE * np.median(source[1])


class Counting(Predictor):
    """Counts how often it is begun."""

    is_asynchronous = True
    has_begun = is_ready = False
    begun_count = 0

    def begin(self, region_count):
        Counting.begun_count += 1
        self.has_begun = True

    def drop(self):
        self.is_ready = False


@pytest.mark.parametrize("asked", [{"candidate_allocation": "FIXED"}, {}])
def test_who_asks_for_candidates_gets_a_network_at_once(asked, monkeypatch):
    monkeypatch.setattr(Counting, "begun_count", 0)
    monkeypatch.setitem(PREDICTORS, "NETWORK", Counting)
    make_learner(RenderSettings(guiding_method="NEURAL_RIS", **asked), 1, 100).close()
    assert Counting.begun_count == (1 if asked else 0)


def test_a_short_render_trains_no_network(monkeypatch):
    monkeypatch.setattr(Counting, "begun_count", 0)
    monkeypatch.setitem(PREDICTORS, "NETWORK", Counting)
    settings = {"samples": 31, "guiding_trial": False, "deterministic": True}
    report = render("NEURAL_RIS", 1, scene=pit_scene, **settings).report.guiding
    assert Counting.begun_count == 0 and "not trained" in report.lines[-1]
    # The mixture weighs candidates of recorded paths meanwhile.
    assert report.candidates_per_vertex > 1.0


#: However short a render, it trains networks.
LATER = Rules(least_paths_left=1.0)


@pytest.fixture
def later(monkeypatch):
    """Networks that know nothing, and say so from the moment on in which they are begun; rendered by `LATER`."""
    guess(monkeypatch)
    made = network_predictor.make_predictor

    def begin_later(*arguments):
        predictor = made(*arguments)
        predictor.is_asynchronous, predictor.has_begun = True, False
        predictor.begin = lambda region_count: setattr(predictor, "has_begun", True)
        return predictor

    monkeypatch.setattr(network_predictor, "make_predictor", begin_later)


def test_bad_networks_are_given_up(later):
    """Held-out records promise nothing of them, so that other paths than recorded ones never ask them."""
    settings = {"samples": 127, "guiding_trial": False, "deterministic": True}
    report = render("NEURAL_RIS", 1, scene=pit_scene, rules=LATER, **settings).report.guiding
    assert report.network_stopped_at and report.network_promise < LATER.network_kept
    assert "given up" in report.lines[-1]


def test_auto_by_a_network_that_is_kept_leaves_the_mean_unchanged(later, monkeypatch):
    """Whatever it promises is taken to be enough, and whatever it does in rendered samples to win."""
    rules = replace(LATER, network_kept=0.0, taken=(0.0, 0.0, 0.0))
    monkeypatch.setitem(METHODS, "AUTO", replace(METHODS["AUTO"], rungs=("VMM", "NEURAL_RIS")))
    settings = {"scene": pit_scene, "samples": 127, "max_bounces": 12, "diffuse_bounces": 12, "deterministic": True}
    found = [render("AUTO", seed, guiding_trial=False, rules=rules, **settings) for seed in range(SEEDS)]
    assert {result.report.guiding.chosen for result in found} == {"NEURAL_RIS"}
    means = np.array([result.passes["Combined"][..., :3].mean() for result in found])
    plain = [render("OFF", seed, **settings).passes["Combined"][..., :3].mean() for seed in range(SEEDS)]
    assert z_score(means, np.array(plain)) < Z_LIMIT
    assert z_score(1.02 * means, np.array(plain)) > Z_LIMIT, "a bias of 2% would be seen"
