# SPDX-License-Identifier: GPL-3.0-or-later
"""Whole renders by networks that know nothing: the same mean, and little more variance than without them."""

from collections import Counter

import numpy as np
import pytest

from engine import learning
from engine.guiding.network import NETWORK_SHAPES, Snapshot, network_shape
from engine.guiding.network_query import make_network_field, no_network
from engine.learning import IterationCosts, Learner
from engine.settings import RenderSettings
from engine.wavefront import integrator
from tests.test_guided_render import Z_LIMIT, pit_scene, render, z_score

SEEDS = 6
#: Most variance over that of source sampling, which `VMM` is; medians over seeds, since a single bright sample doubles
#: that of a render (inverted: 1.08 to 1.29 in sixteen others, 1.15 on average).
MOST_VARIANCE = 1.25


class BadNetwork:
    """Predicts by `kind` instead of by what was learned."""

    def __init__(self, kind: str) -> None:
        self._kind = kind
        self._random = np.random.default_rng(1)

    def __call__(self, table, network, latent, hidden, guide, guided, candidates, row_count):
        rows, directions = candidates.radiance[:row_count], candidates.direction[:row_count]
        if self._kind == "random":
            rows[:] = 10.0 ** self._random.uniform(-2.0, 2.0, rows.shape)
        elif self._kind == "inverted":
            # The pit's light comes from its walls and floor; from the sky comes nothing.
            rows[:] = np.where(directions[:, 2:] > 0.0, 10.0, 1e-3)
        else:
            rows[:] = {"constant": 1.0, "zero": 0.0, "NaN": np.nan}[self._kind]


def ask(network, monkeypatch):
    """Have renders ask `network`, from the first iteration on."""
    field = no_network(NETWORK_SHAPES["COMPACT"])
    monkeypatch.setattr(Learner, "_start_network", lambda learner: setattr(learner, "_network", field))
    monkeypatch.setattr(Learner, "_weighs_network", lambda learner: False)
    monkeypatch.setitem(integrator._STAGES, "predict_radiance", (network, 0))


def guess(monkeypatch):
    """Have renders ask a network whose parameters are drawn at random, and wild; returns the settings it is made by."""
    seen = []

    def start(learner):
        seen.append(learner.settings)
        shape = network_shape(learner.settings)
        rng = np.random.default_rng(learner.settings.seed)
        parameters = rng.normal(0.0, 0.5, shape.parameter_count).astype(np.float32)
        bounds = np.array(((-5.0, -5.0, -5.0), (5.0, 5.0, 5.0)), np.float32)
        learner._network = make_network_field(shape, Snapshot(1, 1, 0.0, 1.0, bounds, parameters))

    monkeypatch.setattr(Learner, "_start_network", start)
    monkeypatch.setattr(Learner, "_weighs_network", lambda learner: False)
    return seen


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


def test_a_network_is_trained_while_it_is_worth_it(monkeypatch):
    started = []
    monkeypatch.setattr(Learner, "_start_network", lambda learner: started.append(learner))

    def learner(**settings):
        made = Learner(RenderSettings(guiding_method="NEURAL_RIS", **settings), 1, 100)
        made.close()
        return made

    def weigh(made, *shares):
        for share in shares:
            costs = IterationCosts(Counter(), 1000, 100, 1000, round(1000 * share), round(4000 * share))
            made._weigh_network(costs, 0.4, 7)

    patient = learner()
    # Recorded are two paths in five, one in four of their vertices may; an eighth of those keep the estimates coming.
    weigh(patient, 0.01, 0.03, 0.02, 0.03)
    assert not started
    weigh(patient, 0.03)
    assert started == [patient]
    patient.report.has_trained = True
    # There is nothing to judge before the first snapshot.
    weigh(patient, 0.0, 0.0)
    assert patient.report.network_stopped_at == 0
    patient._network = no_network(NETWORK_SHAPES["COMPACT"])
    weigh(patient, 0.1, 0.4, 0.1)
    assert patient.report.network_stopped_at == 0
    weigh(patient, 0.1)
    assert patient.report.network_stopped_at == 7 and patient._network is None
    # It does not begin anew.
    weigh(patient, 0.5, 0.5)
    assert len(started) == 1
    # Who asks for a number of candidates, or for the cache, gets a network.
    learner(candidate_allocation="FIXED")
    learner(radiance_cache=True)
    assert len(started) == 3


def test_a_network_that_nothing_asks_for_is_not_trained(monkeypatch):
    def fail(learner):
        raise AssertionError("trained")

    monkeypatch.setattr(learning, "_LEAST_RESAMPLED", 1.1)
    monkeypatch.setattr(Learner, "_start_network", fail)
    report = render("NEURAL_RIS", 1, scene=pit_scene, samples=31, guiding_trial=False).report.guiding
    assert not report.has_trained and "not trained" in report.lines[-1]
    # The mixture weighs candidates of recorded paths meanwhile.
    assert report.candidates_per_vertex > 1.0
