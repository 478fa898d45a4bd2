# SPDX-License-Identifier: GPL-3.0-or-later
"""Whole renders by networks that know nothing: the same mean, and little more variance than without them.

Random and inverted ones cost more than that so far (docs/experiments.md); what resampling does with them is tested in
`test_guided_render`.
"""

import numpy as np
import pytest

from engine.learning import Learner
from tests.test_guided_render import Z_LIMIT, pit_scene, render, z_score

SEEDS = 6
#: Most variance over that of source sampling, which `VMM` is.
MOST_VARIANCE = 1.3


class BadNetwork:
    """Predicts by `kind` instead of by what was learned."""

    def __init__(self, kind: str) -> None:
        self._kind = kind

    def predict(self, positions, candidate_vertex, directions, candidate_count, out):
        rows = out[:candidate_count]
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
@pytest.mark.parametrize("kind", ["constant", "zero", "NaN"])
def test_bad_networks_change_no_mean_and_cost_little_variance(kind, source, monkeypatch):
    def start_network(learner: Learner) -> None:
        learner._new_predictor = lambda: BadNetwork(kind)

    monkeypatch.setattr(Learner, "_start_network", start_network)
    means, variances = np.array([mean_and_variance("NEURAL_RIS", 100 + seed) for seed in range(SEEDS)]).T
    assert z_score(means, source[0]) < Z_LIMIT
    # The test can see a bias of 2%.
    assert z_score(1.02 * means, source[0]) > Z_LIMIT
    assert variances.mean() < MOST_VARIANCE * source[1].mean()
