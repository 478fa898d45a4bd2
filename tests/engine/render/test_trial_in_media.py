# SPDX-License-Identifier: GPL-3.0-or-later
"""Guiding is tried cautiously where there are media: later, by fewer samples, only while regions promise anything."""

from __future__ import annotations

import numpy as np
import pytest

from engine.guiding.models.regions import RegionModels
from engine.guiding.policy import trial
from engine.guiding.policy.rules import RULES
from engine.guiding.policy.trial import GuidingTrial
from engine.render.tiles import TrialTiles
from tests.helpers.media_renders import SIGMAS, means_by_seed, picture, render
from tests.helpers.media_scenes import media_scene, medium, placed
from tests.helpers.small_scenes import corner_scene

#: As few pixels as guiding is tried on a part of, and fewer.
SIZE, SMALL = (80, 52), (32, 16)
AUTO = {"guiding_method": "AUTO", "deterministic": True}


def fog(size=SIZE):
    color = {"Color": (0.9, 0.9, 0.9, 1.0), "Anisotropy": 0.5}
    return media_scene([medium("Scatter", Density=1.0, **color)], [placed()], size=size)


def is_tried(size=SIZE):
    description = fog(size)
    units = TrialTiles(description.frame)
    mask = np.zeros(size[0] * size[1], np.bool_)
    for k in range(units.trial_count):
        mask[units[k][1]] = True
    return mask


def outcome(monkeypatch, *efficiencies):
    """Comparisons show these, one after the other, and the last from then on."""
    left = list(efficiencies)
    monkeypatch.setattr(GuidingTrial, "efficiency", lambda *_: left.pop(0) if len(left) > 1 else left[0])


def promising(monkeypatch, surfaces, media):
    monkeypatch.setattr(RegionModels, "promises", (surfaces, media))


def test_where_guiding_loses_two_samples_of_a_quarter_of_the_pixels_were_guided(film_weights, monkeypatch):
    """And they weigh half."""
    outcome(monkeypatch, 0.3)
    assert render(fog(), samples=32, **AUTO).report.guiding.stopped_at == 8
    weight, mask = film_weights(), is_tried()
    np.testing.assert_array_equal(weight[mask], 0.5 + 3.0 + (2.0 * 0.5 + 2.0) + 24.0)
    np.testing.assert_array_equal(weight[~mask], 0.5 + 31.0)


def test_where_guiding_wins_all_pixels_are_guided_and_weigh_as_elsewhere(film_weights, monkeypatch):
    outcome(monkeypatch, RULES.sure_of_first_part)
    assert render(fog(), samples=32, **AUTO).report.guiding.stopped_at == 0
    later = (2.0 * 6.0 + 2.0) + 2.0 * 16.0
    weight, mask = film_weights(), is_tried()
    np.testing.assert_array_equal(weight[mask], 0.5 + 3.0 + (2.0 * 0.5 + 2.0) + later)
    np.testing.assert_array_equal(weight[~mask], 0.5 + 7.0 + later)


def test_fewer_pixels_are_tried_altogether_as_cautiously(film_weights, monkeypatch):
    outcome(monkeypatch, 0.3)
    render(fog(SMALL), samples=32, **AUTO)
    np.testing.assert_array_equal(film_weights(), 0.5 + 3.0 + (2.0 * 0.5 + 2.0) + 24.0)


def test_without_media_nothing_of_it_is_done(film_weights, monkeypatch):
    """With as many pixels: all are tried, from the second sample on."""
    outcome(monkeypatch, 0.3)
    render(corner_scene(SMALL), samples=32, filter_glossy=0.0, **AUTO)
    assert set(film_weights()) <= {0.5 + 3.0 + (2.0 * 2.0 + 2.0) + 24.0}


def test_guides_learn_first_from_four_samples_that_nothing_guided(monkeypatch):
    learned = []
    learn = RegionModels.fit

    def fit(regions, records, row_count, *others):
        learned.append(bool(np.isnan(records.guide_pdf[:row_count]).all()))
        learn(regions, records, row_count, *others)

    monkeypatch.setattr(RegionModels, "fit", fit)
    outcome(monkeypatch, 0.3)
    of_four = render(fog(), samples=32, **AUTO).report.guiding.record_count
    # Kernels are rehearsed before, on records that were.
    assert learned[-1] and sum(learned) == 1
    # The first sample's records are among them: without media they are learned from alone.
    assert of_four > 1.25 * SIZE[0] * SIZE[1]


def test_a_first_comparison_need_not_show_a_win():
    """Guides know little yet: what pays in the end shows 0.85 and more, most of what does not 0.6 and less."""
    least = RULES.least_of_cautious
    assert trial.least_efficiency(2, 8, 24.0, is_part=True, is_cautious=True) == least < RULES.least_of_first_part
    assert trial.least_efficiency(3, 16, 16.0, is_part=True, is_cautious=True) == RULES.least_of_short
    assert trial.least_efficiency(2, 8, 24.0, is_cautious=True) == least


@pytest.mark.parametrize(
    ("shown", "promises", "samples", "stopped_at"),
    [
        (0.3, (1.0, 1.0), 128, 8),  # neither is tried alone
        (0.3, (1.0, 1.5), 128, 16),  # media alone are, but they lose, and surfaces promise nothing
        (0.8, (1.0, 1.0), 64, 8),  # no benefit of the doubt
        (0.8, (1.5, 1.0), 64, 16),
    ],
)
def test_what_regions_promise_nothing_of_is_not_tried_on(shown, promises, samples, stopped_at, monkeypatch):
    outcome(monkeypatch, shown)
    promising(monkeypatch, *promises)
    assert render(fog(SMALL), samples=samples, **AUTO).report.guiding.stopped_at == stopped_at


@pytest.mark.parametrize("promise", [1.0, 3.0])
def test_where_both_kinds_promise_much_all_pixels_are_guided_once_guiding_has_not_lost(
    promise, film_weights, monkeypatch
):
    outcome(monkeypatch, 0.9, 1.6)
    promising(monkeypatch, promise, 3.0)
    render(fog(), samples=32, **AUTO)
    weight, mask = film_weights(), is_tried()
    of_others = 2.0 * 6.0 + 2.0 if promise > 2.0 else 8.0
    np.testing.assert_array_equal(weight[~mask], 0.5 + 7.0 + of_others + 2.0 * 16.0)


def test_what_has_won_goes_on_whatever_regions_promise(monkeypatch):
    outcome(monkeypatch, 1.6)
    promising(monkeypatch, 1.0, 1.0)
    assert render(fog(SMALL), samples=64, **AUTO).report.guiding.stopped_at == 0


@pytest.mark.parametrize("shown", [0.3, 1.6], ids=["loses", "wins"])
def test_the_image_does_not_depend_on_threads(shown, monkeypatch):
    monkeypatch.setattr(GuidingTrial, "efficiency", lambda *_: shown)
    one, three = (picture(fog(), samples=32, threads=threads, **AUTO) for threads in (1, 3))
    assert np.array_equal(one, three)


@pytest.mark.parametrize("shown", [0.3, 1.6], ids=["loses", "wins"])
def test_the_mean_is_that_of_an_unguided_render(shown, monkeypatch):
    monkeypatch.setattr(GuidingTrial, "efficiency", lambda *_: shown)
    settings = {"samples": 16, "seeds": 6, "volume_bounces": 8, "max_bounces": 12}
    tried = means_by_seed(fog(), **AUTO, **settings)
    plain = means_by_seed(fog(), **settings)
    error = np.sqrt((plain.var(axis=0, ddof=1) + tried.var(axis=0, ddof=1)) / len(plain))
    assert (np.abs(plain.mean(axis=0) - tried.mean(axis=0)) <= SIGMAS * error + 1e-5).all()
    assert (SIGMAS * error < 0.02 * plain.mean(axis=0)).all()
