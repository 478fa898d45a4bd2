# SPDX-License-Identifier: GPL-3.0-or-later
"""Light linking with the radiance cache: neighbours of one material that different lamps light share no cell."""

import numpy as np
import pytest

from engine.guiding.policy.learnables.cache import LearnedCache
from tests.helpers.linked_lights import half_lit_pit
from tests.helpers.seeded_renders import Z_LIMIT, render, z_score

SETTINGS = {"samples": 31, "max_bounces": 32, "diffuse_bounces": 32, "light_sampling_threshold": 0.0}
SEEDS = 4


def means(cache, first):
    """Mean of each render."""
    results = [
        render("OFF", first + seed, scene=half_lit_pit, radiance_cache=cache, **SETTINGS) for seed in range(SEEDS)
    ]
    if cache != "OFF":
        assert min(sum(result.report.cached_shares) for result in results) > 0.2
    return np.array([result.passes["Combined"][..., :3].mean() for result in results])


@pytest.mark.slow
def test_the_mean_is_right_and_halves_of_a_floor_share_no_cell(monkeypatch):
    taught = []
    learn = LearnedCache.learn

    def noted(self, iteration):
        taught.extend(unit.cache_records for unit in iteration.traced.units)
        learn(self, iteration)

    monkeypatch.setattr(LearnedCache, "learn", noted)
    plain, cached = means("OFF", 100), means("CONVERGING", 0)
    assert z_score(cached, plain) < Z_LIMIT
    assert cached.mean() == pytest.approx(plain.mean(), rel=0.02)
    kinds = {True: set(), False: set()}
    for records in taught:
        on_floor = records.normal[:, 2] > 0.9
        for kind, x in zip(records.program[on_floor], records.position[on_floor, 0], strict=True):
            kinds[bool(x > 0.0)].add(int(kind))
    assert len(kinds[True]) == len(kinds[False]) == 1 and kinds[True] != kinds[False]
