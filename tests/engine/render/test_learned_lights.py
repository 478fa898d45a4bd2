# SPDX-License-Identifier: GPL-3.0-or-later
"""Lights chosen by learned visibility without guiding: right, less noisy where lamps are hidden, and only if asked."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import engine.guiding.models.light_selection as light_selection
from engine.settings import RenderSettings
from tests.helpers.light_probe import lamp
from tests.helpers.linked_lights import half_lit_pit, no_linking
from tests.helpers.seeded_renders import Z_LIMIT, render, z_score
from tests.helpers.small_scenes import corner_scene

pytestmark = pytest.mark.estimator

SEEDS, SAMPLES = 6, 31


def split_scene(radius=0.0):
    """A floor with a wall across it: one lamp before it, and seven brighter ones behind it."""
    before = lamp("POINT", (0.0, -1.0, 2.0), energy=60.0, radius=radius)
    behind = [lamp("POINT", (0.5 * k - 1.5, 6.0, 0.5), energy=400.0, radius=0.0) for k in range(7)]
    return replace(corner_scene((32, 24)), lights=[before, *behind])


def images(method, first, choice, count=SEEDS, **settings):
    """float32 (seeds, height, width, 3)"""
    asked = {"samples": SAMPLES, "light_selection": choice} | settings
    renders = [render(method, first + seed, **{"scene": split_scene} | asked) for seed in range(count)]
    return np.stack([result.passes["Combined"][..., :3] for result in renders])


@pytest.fixture(scope="module")
def plain():
    return images("OFF", 100, "TREE")


def test_hidden_lamps_are_left_alone(plain):
    found = images("OFF", 0, "LEARNED")
    assert found.var(axis=0, ddof=1).mean() < 0.7 * plain.var(axis=0, ddof=1).mean()
    assert z_score(found.mean(axis=(1, 2, 3)), plain.mean(axis=(1, 2, 3))) < Z_LIMIT


@pytest.mark.parametrize("wrong", ["backwards", "one cluster alone"])
def test_the_mean_is_right_whatever_was_learned(wrong, plain, monkeypatch):
    probabilities = light_selection.LightSelectionModel.probabilities

    def distorted(model):
        found, pays = probabilities(model)
        found = found[:, ::-1] if wrong == "backwards" else np.eye(found.shape[1])[[0] * len(found)]
        # None is 0 that lights something: that alone keeps the mean.
        found = 0.9 * found + 0.1 / found.shape[1]
        return found, np.ones_like(pays)

    monkeypatch.setattr(light_selection.LightSelectionModel, "probabilities", distorted)
    found = images("OFF", 0, "LEARNED").mean(axis=(1, 2, 3))
    assert z_score(found, plain.mean(axis=(1, 2, 3))) < Z_LIMIT
    # The test can see a bias of 2%.
    assert z_score(1.02 * found, plain.mean(axis=(1, 2, 3))) > Z_LIMIT


def test_the_mean_is_right_whatever_each_direction_chooses(monkeypatch):
    """Also of light that scattering finds: a hit is weighed by what the surface that it was found from would choose."""

    def large_lamp():
        return split_scene(radius=0.6)

    def uneven(model):
        found, pays = probabilities(model)
        rng = np.random.default_rng(len(found))
        found = rng.random(found.shape) ** 6 + 0.02
        return found / found.sum(axis=1)[:, None], np.ones_like(pays)

    probabilities = light_selection.LightSelectionModel.probabilities
    plain = images("OFF", 100, "TREE", scene=large_lamp).mean(axis=(1, 2, 3))
    monkeypatch.setattr(light_selection.LightSelectionModel, "probabilities", uneven)
    found = images("OFF", 0, "LEARNED", scene=large_lamp).mean(axis=(1, 2, 3))
    assert z_score(found, plain) < Z_LIMIT
    assert z_score(1.02 * found, plain) > Z_LIMIT


def linked_pit():
    """A sun and a lamp that scattered rays find too, neither of which lights one half of the floor."""
    scene = half_lit_pit()
    linking = no_linking(len(scene.instances.mesh), 2)
    scene.linking = replace(
        linking, receiver_set=scene.linking.receiver_set, lamp_receivers=np.repeat(scene.linking.lamp_receivers, 2)
    )
    scene.lights = [*scene.lights, lamp("POINT", (-1.0, 0.5, 1.0), energy=100.0, radius=0.4)]
    return scene


@pytest.mark.slow  # compiles stages for links
def test_guided_paths_find_no_lamp_that_does_not_light_what_they_leave():
    settings = {"scene": linked_pit, "max_bounces": 12, "diffuse_bounces": 12, "light_sampling_threshold": 0.0}
    plain = images("OFF", 100, "TREE", **settings).mean(axis=(1, 2, 3))
    guided = images("VMM", 0, "AUTO", guiding_trial=False, learn_guiding_probability=False, **settings)
    found = guided.mean(axis=(1, 2, 3))
    assert z_score(found, plain) < Z_LIMIT
    # The test can see a bias of 3%.
    assert z_score(1.03 * found, plain) > Z_LIMIT


def test_the_image_does_not_depend_on_threads():
    one, three = (images("OFF", 1, "LEARNED", 1, threads=threads) for threads in (1, 3))
    assert np.array_equal(one, three)


def test_off_learns_nothing_unless_asked():
    automatic, by_tree, learned = (
        render("OFF", 1, scene=split_scene, samples=SAMPLES, light_selection=choice)
        for choice in ("AUTO", "TREE", "LEARNED")
    )
    assert np.array_equal(automatic.passes["Combined"], by_tree.passes["Combined"])
    assert by_tree.report.guiding.record_count == 0 and learned.report.guiding.record_count > 0
    assert any("lights:" in line for line in learned.report.guiding.lines)


def test_guided_renders_leave_lights_to_the_tree_where_asked():
    learned, by_tree = (
        render("VMM", 1, scene=split_scene, samples=SAMPLES, light_selection=choice).report.guiding.lights_share
        for choice in ("AUTO", "TREE")
    )
    assert learned > 0.0 and np.isnan(by_tree)


def test_roulette_and_lights_are_learned_together(plain):
    found = images("OFF", 0, "LEARNED", roulette="LEARNED").mean(axis=(1, 2, 3))
    assert z_score(found, plain.mean(axis=(1, 2, 3))) < Z_LIMIT


def test_a_radiance_cache_without_guiding_learns_alone():
    assert not RenderSettings(light_selection="LEARNED", radiance_cache="FAST").learns_lights
    assert RenderSettings(light_selection="LEARNED", radiance_cache="FAST", guiding_method="VMM").learns_lights
    assert not RenderSettings(light_selection="LEARNED", use_nee=False).learns_lights
