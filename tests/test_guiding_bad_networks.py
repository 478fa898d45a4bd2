# SPDX-License-Identifier: GPL-3.0-or-later
"""Whole renders by networks that know nothing: the same mean, and little more variance than without them."""

import numpy as np
import pytest

from engine import learning
from engine.learning import Learner
from tests.test_guided_render import Z_LIMIT, pit_scene, render, z_score

SEEDS = 6
#: Most variance over that of source sampling, which `VMM` is.
MOST_VARIANCE = 1.3


class BadNetwork:
    """Predicts by `kind` instead of by what was learned."""

    def __init__(self, kind: str) -> None:
        self._kind = kind
        self._random = np.random.default_rng(1)

    def predict(self, positions, candidate_vertex, directions, candidate_count, out):
        rows = out[:candidate_count]
        if self._kind == "random":
            rows[:] = 10.0 ** self._random.uniform(-2.0, 2.0, rows.shape)
        elif self._kind == "inverted":
            # The pit's light comes from its walls and floor; from the sky comes nothing.
            rows[:] = np.where(directions[:candidate_count, 2:] > 0.0, 10.0, 1e-3)
        else:
            rows[:] = {"constant": 1.0, "zero": 0.0, "NaN": np.nan}[self._kind]


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
    def start_network(learner: Learner) -> None:
        learner._new_predictor = lambda: BadNetwork(kind)

    monkeypatch.setattr(Learner, "_start_network", start_network)
    # However little it is asked, it stays.
    monkeypatch.setattr(learning, "_LEAST_RESAMPLED", -1.0)
    means, variances = np.array([mean_and_variance("NEURAL_RIS", 100 + seed) for seed in range(SEEDS)]).T
    assert z_score(means, source[0]) < Z_LIMIT
    # The test can see a bias of 2%.
    assert z_score(1.02 * means, source[0]) > Z_LIMIT
    assert variances.mean() < MOST_VARIANCE * source[1].mean()


def test_a_network_that_is_hardly_asked_is_given_up(monkeypatch):
    asked = []

    class Counting(BadNetwork):
        def predict(self, *arguments):
            asked.append(None)
            super().predict(*arguments)

    monkeypatch.setattr(Learner, "_start_network", lambda learner: setattr(learner, "_new_predictor", make))

    def make():
        return Counting("constant")

    def report(**settings):
        asked.clear()
        return render("NEURAL_RIS", 1, scene=pit_scene, samples=31, guiding_trial=False, **settings).report.guiding

    def stopped_at(least):
        monkeypatch.setattr(learning, "_LEAST_RESAMPLED", least)
        return report().network_stopped_at

    assert stopped_at(-1.0) == 0
    everywhere = len(asked)
    # Asked from the first iteration on, whose paths are not guided yet: 1 and 2 samples.
    assert stopped_at(1.1) == 3
    assert len(asked) < 0.5 * everywhere
    # Who asks for a number of candidates gets it.
    fixed = report(candidate_allocation="FIXED", candidate_count=3)
    assert fixed.network_stopped_at == 0 and fixed.candidates_per_vertex == pytest.approx(3.0)
