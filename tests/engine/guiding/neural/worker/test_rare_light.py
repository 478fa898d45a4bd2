# SPDX-License-Identifier: GPL-3.0-or-later
"""Light that few records have is learned as what it is on average: the loss must not take it for outliers.

Half of a box's records, those in its right half, see light of mean 1 by a share `f` of them that has 1/f. The left half
is dark. In a render one record in a hundred is lit.
"""

import numpy as np
import pytest

from tests.helpers.guiding_harness import random_directions
from tests.helpers.radiance_networks import BOUNDS, SHAPE
from tests.helpers.training import require_torch

ROWS = 200_000


def rare_rows(share, count, seed):
    """Rows of float32 (count, 9): position, direction, radiance."""
    rng = np.random.default_rng(seed)
    rows = np.zeros((count, 9), np.float32)
    rows[:, :3] = rng.uniform(BOUNDS[0], BOUNDS[1], (count, 3))
    rows[:, 3:6] = random_directions(rng, count)
    is_lit = (rows[:, 0] > BOUNDS.mean(0)[0]) & (rng.random(count) < share)
    rows[is_lit, 6:] = 1.0 / share
    return rows


@pytest.mark.parametrize("share", [0.001, 0.01, 0.09])
def test_rare_light_keeps_its_mean(share):
    require_torch()
    from engine.guiding.neural.networks.radiance import TrainingSettings
    from engine.guiding.neural.worker.radiance_training import RadianceTraining

    training = RadianceTraining(SHAPE, TrainingSettings(), seed=1, bounds=BOUNDS)
    training.add(rare_rows(share, ROWS, 1))
    while training.step_count * training.settings.batch_size < training.looks_worth:
        training.step()
    test = rare_rows(share, 20_000, 2)
    predicted = training.predict(test).mean(1)
    is_right = test[:, 0] > BOUNDS.mean(0)[0]
    right, left = predicted[is_right], predicted[~is_right]
    # One seed: with 0.1% there are a hundred lit rows, and their number alone has a standard deviation of 10%.
    assert 0.35 < predicted.mean() < 0.65
    assert np.percentile(right, 5.0) > 0.1
    assert right.mean() > 0.9 * left.mean()
    if share > 0.005:
        assert right.mean() > 1.2 * left.mean()


def test_the_best_parameters_stay():
    torch = require_torch()
    from engine.guiding.neural.worker.overfitting import BestParameters

    generator = torch.Generator().manual_seed(1)
    base = torch.rand(1000, generator=generator)
    noise = torch.randn(1000, generator=generator)
    noise -= noise.mean()
    best, parameters = BestParameters(), torch.zeros(3)
    assert not best.is_known
    assert not best.see(base, parameters) and best.is_known
    parameters += 1.0
    assert not best.see(base - 0.1, parameters)
    parameters += 1.0
    # Above the best by half a standard error, then by two.
    assert not best.see(base - 0.1 + noise + 0.5 * noise.std() / 1000**0.5, parameters)
    assert parameters.tolist() == [2.0] * 3
    assert best.see(base - 0.1 + noise + 2.0 * noise.std() / 1000**0.5, parameters)
    assert parameters.tolist() == [1.0] * 3
    best.forget()
    assert not best.is_known and not best.see(base + 9.0, parameters)


def test_training_that_is_worn_rests_until_rows_come():
    require_torch()
    from engine.guiding.neural.networks.radiance import TrainingSettings
    from engine.guiding.neural.worker.radiance_training import RadianceTraining

    training = RadianceTraining(SHAPE, TrainingSettings(), seed=1, bounds=BOUNDS)
    training.add(rare_rows(0.01, 50_000, 1))
    for _ in range(100):
        training.step()
    # By far more looks than the rows are worth: those held out are told from those learned.
    assert training.looks_worth == 0.0
    training.add(rare_rows(0.01, 50_000, 2))
    assert training.looks_worth > 0.0
