# SPDX-License-Identifier: GPL-3.0-or-later
"""Clamping does not see how a path was sampled: the clamped picture is that of plain sampling, whatever was learned."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import engine.guiding.models.light_selection as light_selection
from engine.kernels.clamping import Unguided, clamped_share, weighted_inverse
from engine.kernels.radiance import power_heuristic
from engine.scene.fast_gi import FastGi
from engine.settings import RenderSettings
from engine.wavefront.options import make_options
from tests.helpers.light_probe import lamp
from tests.helpers.seeded_renders import Z_LIMIT, render, z_score
from tests.helpers.small_scenes import pit_scene

pytestmark = pytest.mark.estimator

SEEDS = 8
#: Limits that take a third of the light.
CLAMPED = {"samples": 63, "max_bounces": 12, "diffuse_bounces": 12, "clamp_indirect": 0.1, "clamp_direct": 0.3}


def lamps_in_a_pit():
    """A lamp that is found by scattering too, close to a wall, and two that are hidden from most of the pit."""
    near = lamp("POINT", (2.6, 0.0, 0.6), energy=40.0, radius=0.15)
    below = [lamp("POINT", (x, 0.5, -1.0), energy=400.0, radius=0.0) for x in (-1.0, 1.0)]
    return replace(pit_scene((24, 24)), lights=[near, *below])


def means(method, first=0, count=SEEDS, **settings):
    """Image mean by seed."""
    asked = {"scene": lamps_in_a_pit} | CLAMPED | settings
    return np.array(
        [render(method, first + seed, **asked).passes["Combined"][..., :3].mean() for seed in range(count)]
    )


@pytest.fixture(scope="module")
def plain():
    return means("OFF", 100)


def test_the_limits_take_much(plain):
    whole = means("OFF", 100, 2, clamp_indirect=0.0, clamp_direct=0.0)
    assert plain.mean() < 0.75 * whole.mean()


@pytest.mark.parametrize(
    "method, settings",
    [
        ("VMM", {"guiding_trial": False}),
        ("VMM_RIS", {"guiding_trial": False, "candidate_count": 4}),
        ("SDTREE", {"guiding_trial": False}),
        ("OFF", {"radiance_cache": "CONVERGING"}),
        ("VMM", {"guiding_trial": False, "radiance_cache": "CONVERGING"}),
        ("OFF", {"light_selection": "LEARNED"}),
    ],
    ids=["mixtures", "resampled", "trees", "cache", "cache-and-mixtures", "roulette-and-lights"],
)
def test_the_clamped_picture_is_that_of_plain_sampling(method, settings, plain):
    found = means(method, **settings)
    assert z_score(found, plain) < Z_LIMIT
    # The test can see a bias of 3%.
    assert z_score(1.03 * found, plain) > Z_LIMIT


def test_lights_that_are_chosen_otherwise_are_clamped_as_by_the_tree(plain, monkeypatch):
    """Every second light sample goes to the lamp that the tree would choose least."""
    probabilities = light_selection.LightSelectionModel.probabilities

    def distorted(model):
        found, pays = probabilities(model)
        return found[:, ::-1], np.ones_like(pays)

    monkeypatch.setattr(light_selection.LightSelectionModel, "probabilities", distorted)
    assert z_score(means("OFF", light_selection="LEARNED"), plain) < Z_LIMIT


def test_both_techniques_multiply_by_the_same_number():
    """By hand: f = 6 in one channel, found with densities 0.5 by scattering and 2 by light sampling; the limit is 1."""
    options = make_options(RenderSettings(clamp_indirect=1.0 / 3.0), 1.0, 1.0, FastGi())
    scatter, light, f, channels = np.float32(0.5), np.float32(2.0), np.float32(6.0), (0, 1, 2)
    by_scattering, by_light = power_heuristic(scatter, light), power_heuristic(light, scatter)
    assert by_scattering == pytest.approx(1.0 / 17.0) and by_light == pytest.approx(16.0 / 17.0)
    expected = by_scattering * min(1.0, scatter / (f * by_scattering)) + by_light * min(1.0, light / (f * by_light))
    # A guide of density 4, which nothing of this may depend on, with weights of its own.
    for own, other in ((scatter, light), (light, scatter)):
        used = np.float32(4.0) if own == scatter else own
        rival = light if own == scatter else np.float32(4.0)
        contribution = np.array([[f * weighted_inverse(used, rival), 0.0, 0.0]], np.float32)
        factors = Unguided(
            np.float32(weighted_inverse(own, other) / weighted_inverse(used, rival)),
            np.float32(weighted_inverse(other, own) / weighted_inverse(used, rival)),
            np.float32(power_heuristic(own, other)),
        )
        assert clamped_share(options, channels, contribution, 0, 1, factors) == pytest.approx(expected, rel=1e-5)


def test_the_weight_over_a_density_does_not_overflow():
    assert weighted_inverse(np.float32(0.0), np.float32(1.0)) == 0.0
    assert weighted_inverse(np.float32(2.0), np.float32(0.0)) == pytest.approx(0.5)
    assert weighted_inverse(np.float32(1e30), np.float32(1e30)) == pytest.approx(0.5e-30, rel=1e-5)
    assert weighted_inverse(np.float32(1e-25), np.float32(1e25)) == pytest.approx(0.0, abs=1e-30)
