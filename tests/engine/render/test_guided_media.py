# SPDX-License-Identifier: GPL-3.0-or-later
"""Guided renders of media, by every source and with several candidates: unbiased, whatever was learned.

Statistical tests have fixed seeds and reject at 4 standard errors, or by `is_mean`, which a correct renderer fails once
in 1,000.
"""

from __future__ import annotations

import numpy as np
import pytest

from engine.guiding.models.regions import RegionModels
from engine.guiding.policy import sets
from engine.guiding.policy.questions.media import MediaTrial
from engine.guiding.policy.trial import GuidingTrial
from engine.guiding.policy.way import BOTH, MEDIA, SURFACES
from engine.scene.description import Light, SceneDescription
from tests.helpers.media_renders import is_mean, means_by_seed, picture, render
from tests.helpers.media_scenes import media_scene, medium, placed, varying
from tests.helpers.some_cases import every
from tests.helpers.untrained_networks import Untrained

pytestmark = pytest.mark.estimator

#: Enough for the furnace: what is left of paths beyond is next to nothing.
BOUNCES = {"volume_bounces": 64, "max_bounces": 64}


def furnace(varies: bool):
    """Fog that scatters all light, under an even sky: whatever paths are guided by, it is not seen."""
    color = {"Color": (1.0, 1.0, 1.0, 1.0), "Anisotropy": 0.6}
    fog = varying("Scatter", "Density", 2.0, **color) if varies else medium("Scatter", Density=1.0, **color)
    return media_scene([fog], [placed()])


def foggy_box(size=(8, 8)):
    """Fog between a floor and a lamp, in the dark."""
    fog = medium("Scatter", Color=(0.9, 0.8, 0.7, 1.0), Density=0.5, Anisotropy=0.4)
    floor = medium("Absorption", "ShaderNodeBsdfDiffuse", name="Floor", Density=0.0)
    lamp = Light("lamp", "Lamp", "AREA", placed(offset=(1.0, 0.0, 4.0)), (1.0, 1.0, 1.0), 200.0, size_x=1.0)
    around = [placed((3.0, 3.0, 2.0), (0.0, 0.0, 2.0)), placed((4.0, 4.0, 0.5), (0.0, 0.0, -0.6))]
    return media_scene([fog, floor], around, lights=[lamp], world=(0.0, 0.0, 0.0), size=size)


def guided(method, **settings):
    """Settings for guiding half of the scatterings everywhere, whether or not it pays."""
    fixed = {"guiding_trial": False, "learn_guiding_probability": False}
    return {"guiding_method": method, "samples": 127, **fixed, **BOUNCES, **settings}


@pytest.mark.parametrize("method", ["VMM", "VMM_RIS"])
def test_the_furnace_stays_white_however_collisions_are_guided(method):
    means = means_by_seed(furnace(False), **guided(method))
    assert is_mean(means, np.ones(3))
    # And the test sees a bias of 2%.
    assert not is_mean(1.02 * means, np.ones(3))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("method", "varies"), [("VMM_RIS", True), ("TABLE_RIS", False), ("SDTREE", True), ("SDTREE_VARIANCE", False)]
)
def test_the_furnace_stays_white_by_other_methods_and_where_fog_varies(method, varies):
    means = means_by_seed(furnace(varies), **guided(method))
    assert is_mean(means, np.ones(3))
    assert not is_mean(1.02 * means, np.ones(3))


@pytest.mark.slow
@pytest.mark.parametrize("method", every(["NEURAL_RIS", "NASG", "NPM"], 2))
def test_the_furnace_stays_white_by_networks(method):
    means = means_by_seed(
        furnace(False), **guided(method, deterministic=True, candidate_allocation="FIXED", candidate_count=4)
    )
    assert is_mean(means, np.ones(3))
    # A bias of 5% is seen: these are noisy, and networks take long.
    assert not is_mean(1.05 * means, np.ones(3))


@pytest.mark.slow
@pytest.mark.parametrize("method", ["NPM", "NASG"])
def test_the_furnace_stays_white_by_networks_that_know_nothing(method, monkeypatch):
    """Their parameters are drawn at random, and wild: no other is as wrong."""
    monkeypatch.setattr(sets, "make_source_model", lambda settings: Untrained(settings, 4.0))
    means = means_by_seed(furnace(False), **guided(method, samples=255))
    assert is_mean(means, np.ones(3))
    # A bias of 5% is seen: these are noisy, and networks take long.
    assert not is_mean(1.05 * means, np.ones(3))


@pytest.mark.slow
def test_mixtures_that_see_the_wavelength_keep_the_mean(monkeypatch):
    """Each wavelength scatters by another mixture, a wild one: the shares of the path's wavelengths must follow."""
    monkeypatch.setattr(sets, "make_source_model", lambda settings: Untrained(settings, 4.0))
    scene = furnace(False)
    # Out of sight, so that there are wavelengths to tell apart.
    monkeypatch.setattr(SceneDescription, "has_dispersion", True)
    settings = {"samples": 511, "spectral": "ON", "seeds": 4}
    means = means_by_seed(scene, **guided("NPM", mixture_u="FREQUENCY", **settings))
    expected = means_by_seed(media_scene([], np.zeros((0, 4, 4))), **settings)
    error = np.sqrt((means.var(axis=0, ddof=1) + expected.var(axis=0, ddof=1)) / len(means))
    difference = np.abs(means.mean(axis=0) - expected.mean(axis=0))
    assert (difference <= 4.0 * error + 1e-4).all()
    assert (4.0 * error < 0.03 * expected.mean(axis=0)).all()


def test_collisions_draw_as_many_candidates_as_asked_for_or_allocated(monkeypatch):
    scene = media_scene([medium("Scatter", Color=(0.9, 0.9, 0.9, 1.0), Density=2.0)], [placed()])
    report = render(scene, **guided("VMM_RIS", samples=15, candidate_count=4)).report.guiding
    assert report.candidates_per_vertex == pytest.approx(4.0)
    mean_deltas = RegionModels.variance_deltas

    def deltas(regions):
        known = mean_deltas(regions)
        # There are no surfaces: rows of collisions come second.
        known[: len(known) // 2], known[len(known) // 2 :] = -1.0, 1e9
        return known

    monkeypatch.setattr(RegionModels, "variance_deltas", deltas)
    report = render(scene, **guided("VMM_RIS", samples=15, candidate_count=4)).report.guiding
    assert report.guides == BOTH and report.guided_media_share == 1.0
    report = render(scene, **guided("TABLE_RIS", samples=31)).report.guiding
    assert report.candidates_per_vertex > 2.0


@pytest.mark.parametrize("method", ["VMM", "VMM_RIS"])
def test_the_picture_does_not_depend_on_threads(method):
    one, two = (
        picture(foggy_box((48, 40)), **guided(method, samples=15, threads=threads)) for threads in (1, 2)
    )
    assert np.array_equal(one, two)


@pytest.mark.parametrize(("samples", "stopped_at"), [(63, 8), (255, 32)])
def test_media_and_surfaces_are_tried_apart_only_where_much_is_left(samples, stopped_at, monkeypatch):
    """Each of them takes an iteration: of 63 samples these would be a third."""
    monkeypatch.setattr(GuidingTrial, "efficiency", lambda trial, weights: 0.3)
    settings = guided("VMM", samples=samples, guiding_trial=True, learn_guiding_probability=True)
    assert render(foggy_box(), **settings).report.guiding.stopped_at == stopped_at


@pytest.mark.slow
@pytest.mark.parametrize("scope", [SURFACES, MEDIA])
def test_guiding_one_of_the_two_alone_keeps_the_mean(scope, monkeypatch):
    begin = MediaTrial.__init__

    def begin_with(trial, *arguments):
        begin(trial, *arguments)
        trial.guided = scope

    monkeypatch.setattr(MediaTrial, "__init__", begin_with)
    alone = means_by_seed(foggy_box((20, 20)), **guided("VMM_RIS", samples=255, volume_bounces=4, max_bounces=12))
    plain = means_by_seed(foggy_box((20, 20)), samples=255, volume_bounces=4, max_bounces=12)
    error = np.sqrt((plain.var(axis=0, ddof=1) + alone.var(axis=0, ddof=1)) / len(plain))
    assert (np.abs(plain.mean(axis=0) - alone.mean(axis=0)) <= 4.0 * error).all()
    assert (4.0 * error < 0.02 * plain.mean(axis=0)).all()
