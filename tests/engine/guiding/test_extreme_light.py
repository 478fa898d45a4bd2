# SPDX-License-Identifier: GPL-3.0-or-later
"""Guided renders of black and of absurdly bright scenes: numpy has nothing to warn of, and passes are numbers."""

from __future__ import annotations

import warnings

import numpy as np
import pytest

from engine.guiding.fields.state import MOST
from engine.guiding.models.light_share import LEAST_SHARE, LightShareModel
from engine.guiding.models.selection import PROBABILITIES, SelectionModel
from engine.render.session import Session
from engine.ris.orca import CandidateCosts, image_variance, make_allocation, pixel_weights
from engine.settings import RenderSettings
from tests.helpers.learned_fields import learned_models, random_records
from tests.helpers.small_scenes import floor_scene, sun

pytestmark = pytest.mark.filterwarnings("error::RuntimeWarning")

PASSES = ("Combined", "Variance", "Guiding Benefit", "Candidate Count")
SETTINGS = [
    {"guiding_method": "AUTO"}, {"guiding_method": "VMM", "guiding_trial": False},
    {"guiding_method": "TABLE_RIS", "guiding_trial": False},
    {"guiding_method": "VMM", "guiding_trial": False, "radiance_cache": "CONVERGING"},
    {"guiding_method": "VMM", "light_selection": "LEARNED", "roulette": "LEARNED"},
]  # fmt: skip


@pytest.mark.parametrize("settings", SETTINGS)
@pytest.mark.parametrize("strength", [0.0, 1e-44, 1e-20, 1e17, 1e22, 1e37])
def test_any_light_gives_numbers(settings: dict[str, object], strength: float) -> None:
    session = Session(RenderSettings(samples=32, threads=1, deterministic=True, **settings))  # type: ignore[arg-type]
    session.load(floor_scene(lights=[sun(strength)], size=(24, 16)))
    result = session.render(passes=PASSES, keep=True)
    session.close()
    for name in PASSES:
        assert np.isfinite(result.passes[name]).all(), name
    if strength > 1.0:
        assert result.passes["Combined"][..., :3].max() > 0.0


@pytest.mark.parametrize("brightness", [0.0, 1e-45, 1e-30, 1.0, 1e30, 3e38])
def test_weights_of_pixels_are_numbers_whatever_the_picture(brightness: float) -> None:
    mean = np.full((4, 5, 3), brightness, np.float32)
    weights = pixel_weights(mean)
    assert weights.dtype == np.float32 and np.isfinite(weights).all() and (weights > 0.0).all()
    variance = np.array([1.0, np.nan, np.inf, 0.0] * 5)
    assert np.isfinite(image_variance(variance, weights))


@pytest.mark.parametrize("variance", [0.0, 5e-324, 1e-300, 1.0, 1e300])
@pytest.mark.parametrize("ray_count", [0.0, 1.0, 1e12])
def test_allocations_and_shares_are_numbers(variance: float, ray_count: float) -> None:
    allocation = make_allocation(np.ones(3, np.float32), ray_count=ray_count, variance=variance, costs=CandidateCosts())
    assert all(np.isfinite(np.asarray(part)).all() for part in (allocation.variance_delta, allocation.constants))
    regions, _ = learned_models(0)
    records = random_records(5)
    leaf = np.zeros(len(records.pdf), np.int32)
    share = LightShareModel.of_state(regions.light_share.state(), regions.mixture.region_count)
    share.update(regions.mixture, records, leaf, variance=variance, ray_count=ray_count)
    assert (share.share >= np.float32(LEAST_SHARE)).all() and (share.share <= 1.0).all()


def test_a_selection_of_absurd_sums_is_one_of_probabilities() -> None:
    regions, _ = learned_models(0)
    count = regions.mixture.region_count
    state = regions.selection.state()
    state["sums"] = np.full((count, len(PROBABILITIES) + 2), float(MOST))
    state["sums"][:, 5] = 0.0  # of the reference: nothing, with much beside it
    model = SelectionModel.of_state(state, 0.5, count)
    records = random_records(5)
    model.update(regions.mixture, records, np.zeros(len(records.pdf), np.int32), variance=1.0, ray_count=4.0)
    assert np.isin(model.probability, PROBABILITIES).all() and np.isfinite(model.benefit).all()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert np.isfinite(model.promise)
