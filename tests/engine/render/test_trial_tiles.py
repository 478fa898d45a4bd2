# SPDX-License-Identifier: GPL-3.0-or-later
"""Guiding is tried on an even quarter of the pixels: which these are, and that others are not guided before it wins."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from engine.guiding.policy import trial
from engine.render.render_loop import RenderLoop
from engine.render.session import Session
from engine.render.tiles import FrameTiles, TrialTiles
from engine.settings import RenderSettings
from engine.state.unit import CHALLENGER
from tests.helpers.seeded_renders import SEEDS, Z_LIMIT, render, trial_rules, z_score
from tests.helpers.small_scenes import corner_scene, pit_scene

#: Enough pixels for a part of them to say something; units at its right and upper border have few or none.
SIZE = (90, 70)
REGIONS = [(0, 0, *SIZE), (3, 5, 68, 71), (0, 0, 1, 64), (0, 0, 1, 1), (16, 0, 80, 64)]


def scene():
    return corner_scene(SIZE)


def tiles(region):
    frame = replace(corner_scene().frame, region=region)
    return TrialTiles(frame), FrameTiles(frame)


@pytest.mark.parametrize("region", REGIONS)
def test_units_have_every_pixel_once_and_are_no_larger_than_tiles(region):
    units, whole = tiles(region)
    places = {int(index): tuple(pixel) for tile in whole for pixel, index in zip(*tile, strict=True)}
    found = [(int(index), tuple(pixel)) for unit in units for pixel, index in zip(*unit, strict=True)]
    assert len(found) == len(places) and dict(found) == places
    assert max(len(index) for _, index in units) <= whole.largest
    assert sum(len(units[k][1]) for k in range(units.trial_count)) == units.trial_pixels
    with pytest.raises(IndexError):
        units[len(units)]


def test_a_pixel_of_each_quad_is_tried_and_which_one_follows_no_pattern():
    units, _ = tiles((0, 0, 256, 128))
    mask = np.zeros((128, 256), np.int64)
    for k in range(units.trial_count):
        pixels, _ = units[k]
        mask[pixels[:, 1], pixels[:, 0]] = 1
    quads = mask.reshape(64, 2, 128, 2).transpose(0, 2, 1, 3).reshape(64, 128, 4)
    assert (quads.sum(axis=2) == 1).all()
    chosen = quads.argmax(axis=2)
    assert np.bincount(chosen.ravel(), minlength=4).min() > 0.22 * chosen.size
    # Neighbours say nothing of each other: 0.05 is four standard errors.
    for one, other in ((chosen[1:], chosen[:-1]), (chosen[:, 1:], chosen[:, :-1])):
        for place in range(4):
            assert abs(np.corrcoef((one == place).ravel(), (other == place).ravel())[0, 1]) < 0.05


def outcome(least, clear=1e9, **others):
    """Rules by which comparisons with unguided rendering end so."""
    return trial_rules(least, clear, **{"least_of_first_part": least, **others})



def is_tried():
    units, whole = tiles((0, 0, *SIZE))
    mask = np.zeros(whole.pixel_count, np.bool_)
    for k in range(units.trial_count):
        mask[units[k][1]] = True
    return mask


def test_where_guiding_loses_only_a_quarter_of_the_pixels_was_guided(film_weights):
    """1 of 32 samples teaches, 3 are guided by that, 2 + 2 compared, and the rest unguided; elsewhere all are."""
    rules = outcome(1e9)
    report = render("VMM", 1, scene=scene, samples=32, rules=rules).report
    assert report.guiding.stopped_at == 8 and report.sample_count == 32
    weight, mask = film_weights(), is_tried()
    np.testing.assert_array_equal(weight[mask], 0.5 + 3.0 + (2.0 * 2.0 + 2.0) + 24.0)
    np.testing.assert_array_equal(weight[~mask], 0.5 + 31.0)


def test_where_guiding_wins_all_pixels_are_guided(film_weights):
    rules = outcome(0.0, least_of_short=-1.0, sure_of_first_part=-1.0)
    assert render("VMM", 1, scene=scene, samples=32, rules=rules).report.guiding.stopped_at == 0
    weight, mask = film_weights(), is_tried()
    later = (2.0 * 6.0 + 2.0) + 2.0 * 16.0
    np.testing.assert_array_equal(weight[mask], 0.5 + 3.0 + (2.0 * 2.0 + 2.0) + later)
    np.testing.assert_array_equal(weight[~mask], 0.5 + 7.0 + later)


def test_what_a_quarter_shows_at_first_has_to_be_clear(film_weights):
    """Else the second comparison is of a quarter too."""
    rules = outcome(0.0, least_of_short=-1.0, sure_of_first_part=1e9)
    render("VMM", 1, scene=scene, samples=32, rules=rules)
    weight, mask = film_weights(), is_tried()
    np.testing.assert_array_equal(weight[mask], 0.5 + 3.0 + (2.0 * 2.0 + 2.0) + (2.0 * 6.0 + 2.0) + 2.0 * 16.0)
    np.testing.assert_array_equal(weight[~mask], 0.5 + 15.0 + 2.0 * 16.0)


@pytest.mark.parametrize(
    "changes",
    [{"guiding_trial": False}, {"sample_weighting": "UNIFORM"}, {"radiance_cache": "CONVERGING"}],
    ids=["no trial", "weights that are one", "radiance cache"],
)
def test_without_weights_of_a_trial_all_pixels_are_guided_alike(changes, film_weights):
    render("VMM", 1, scene=scene, samples=16, **changes)
    assert len(np.unique(film_weights())) == 1


def test_few_pixels_are_tried_altogether(film_weights):
    rules = outcome(1e9)
    render("VMM", 1, scene=lambda: corner_scene((60, 60)), samples=32, rules=rules)
    assert len(np.unique(film_weights())) == 1


def test_unguided_pixels_cost_a_trial_nothing(monkeypatch):
    """What they take is no part of the costs that are compared, and what they are, no part of the records."""
    rules = outcome(1e9)
    compared = []
    add_cost = trial.GuidingTrial.add_cost

    def added(tried, cost, path_count, is_challenger):
        compared.append(path_count)
        add_cost(tried, cost, path_count, is_challenger)

    monkeypatch.setattr(trial.GuidingTrial, "add_cost", added)
    render("VMM", 1, scene=scene, samples=32, deterministic=True, rules=rules)
    assert sum(compared) == 4 * is_tried().sum()


def arms_of_units(monkeypatch):
    """Arms of all units, in the order in which they were put on the film."""
    arms = []
    keep_alike = RenderLoop.keep_alike

    def kept(loop, tasks, *others):
        arms.extend(task.arm_samples.arm for task in tasks)
        keep_alike(loop, tasks, *others)

    monkeypatch.setattr(RenderLoop, "keep_alike", kept)
    return arms


@pytest.mark.parametrize(("size", "renders_for_it"), [(SIZE, False), ((60, 60), True)])
def test_roulette_is_compared_by_pixels_that_were_not_guided(size, renders_for_it, monkeypatch):
    """They had samples by the throughput, and by what was learned. Where all were guided samples are taken for it."""
    rules = outcome(1e9)
    arms = arms_of_units(monkeypatch)
    settings = {"scene": lambda: corner_scene(size), "samples": 32, "deterministic": True}
    report = render("AUTO", 1, rules=rules, **settings).report.guiding
    assert report.stopped_at == 8
    assert report.trials[-1].startswith("learned roulette over OFF")
    assert report.trials[-1].endswith("at sample 16" if renders_for_it else "at sample 8")
    assert (CHALLENGER in arms) == renders_for_it


@pytest.mark.parametrize("least", [0.0, 1e9])
def test_roulette_that_loses_elsewhere_is_left(least):
    rules = outcome(1e9, roulette_least_efficiency=least)
    guidance = render("AUTO", 1, scene=scene, samples=32, deterministic=True, rules=rules).guidance
    assert (guidance.roulette_field is not None) == (least == 0.0)


@pytest.mark.parametrize("least", [0.0, 1e9], ids=["wins", "loses"])
def test_the_image_does_not_depend_on_threads(least):
    rules = outcome(least)
    one, three = (
        render("AUTO", 3, scene=scene, samples=32, threads=threads, deterministic=True, rules=rules)
        for threads in (1, 3)
    )
    assert np.array_equal(one.passes["Combined"], three.passes["Combined"])
    assert one.report.guiding.efficiency == three.report.guiding.efficiency


def test_the_mean_is_that_of_an_unguided_render():
    """In the pixels of the trial and in the others, guided from some sample on."""
    rules = outcome(0.0)
    deep = {"scene": lambda: pit_scene((80, 64)), "samples": 32, "max_bounces": 12, "diffuse_bounces": 12}
    units = TrialTiles(pit_scene((80, 64)).frame)
    mask = np.zeros(80 * 64, np.bool_)
    for k in range(units.trial_count):
        mask[units[k][1]] = True

    def means(method, first):
        results = [render(method, first + s, rules=rules, **deep) for s in range(SEEDS)]
        images = [result.passes["Combined"][..., :3].reshape(-1, 3) for result in results]
        return [np.array([image[chosen].mean() for image in images]) for chosen in (mask, ~mask)]

    for found, plain in zip(means("VMM", 0), means("OFF", 100), strict=True):
        assert z_score(found, plain) < Z_LIMIT
        assert z_score(1.05 * found, plain) > Z_LIMIT, "a bias of 5% would be seen"


def test_a_noise_threshold_and_a_trial_go_together():
    """Pixels that have converged get no more samples, though the units of the trial had them."""
    rules = outcome(0.5)
    shared = {"samples": 96, "use_adaptive_sampling": True, "adaptive_threshold": 0.1, "adaptive_min_samples": 4}
    passes = ("Combined", "Sample Count")
    one, two = (
        render("VMM", 2, scene=scene, passes=passes, rules=rules, threads=threads, deterministic=True, **shared)
        for threads in (1, 2)
    )
    assert np.array_equal(one.passes["Combined"], two.passes["Combined"])
    count = one.passes["Sample Count"]
    assert count.min() >= 8 and count.mean() < 96


def test_a_last_iteration_records_and_compares_nothing(film_weights):
    """Nobody would go by it, unless what was learned is kept."""
    rules = outcome(0.0, least_of_short=-1.0, sure_of_first_part=-1.0)
    settings = RenderSettings(samples=16, seed=1, guiding_method="VMM", max_bounces=6)
    session = Session(settings, rules=rules)
    session.load(scene())
    for keep in (False, True):
        result = session.render(keep=keep)
        assert (result.guidance.record_threshold > 0) == keep
        last = 2.0 * 6.0 + 2.0 if keep else 2.0 * 8.0
        np.testing.assert_array_equal(film_weights()[is_tried()], 0.5 + 3.0 + (2.0 * 2.0 + 2.0) + last)
    session.close()


def test_tiles_are_the_frame_s_again_after_the_trial(monkeypatch):
    """Workers of a cluster then know them by number."""
    rules = outcome(1e9)
    seen = []
    begin_next = RenderLoop.begin_next

    def begun(loop, *arguments, **options):
        begin_next(loop, *arguments, **options)
        seen.append((type(loop.tiles), loop.has_all_pixels))

    monkeypatch.setattr(RenderLoop, "begin_next", begun)
    render("VMM", 1, scene=scene, samples=32, rules=rules)
    assert seen == [(TrialTiles, False), (TrialTiles, False), (FrameTiles, True)]
