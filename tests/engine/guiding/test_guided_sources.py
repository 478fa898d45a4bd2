# SPDX-License-Identifier: GPL-3.0-or-later
"""Whole renders by every source of directions: whatever it has learned, the mean is that of an unguided render."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from engine.guiding.neural.sources import network_design
from engine.guiding.policy import sets
from engine.guiding.records.vertices import allocate_vertex_records, compensate
from engine.methods import SOURCES
from tests.helpers.pits import PITS
from tests.helpers.seeded_renders import Z_LIMIT, render, z_score
from tests.helpers.small_scenes import corner_scene, pit_scene
from tests.helpers.some_cases import every
from tests.helpers.training import refuse_workers, require_torch
from tests.helpers.untrained_networks import Late, Untrained

SEEDS = 6
NETWORK_SOURCES = [source.name for source in SOURCES.values() if source.is_network]
TREES = ("SDTREE", "SDTREE_VARIANCE")
LONG = (pytest.mark.slow, pytest.mark.one_of_many)
LONGEST = {"samples": 63, "max_bounces": 12, "diffuse_bounces": 12, "guiding_trial": False}


def means(method, seeds=SEEDS, **settings):
    return np.array(
        [
            render(method, seed, scene=pit_scene, **(LONGEST | settings)).passes["Combined"][..., :3].mean()
            for seed in range(seeds)
        ]
    )


@pytest.fixture(scope="module")
def plain():
    return means("OFF")


def check_mean(guided, plain):
    assert z_score(guided, plain) < Z_LIMIT
    # The test can see a bias of 2%.
    assert z_score(1.02 * guided, plain) > Z_LIMIT


@pytest.mark.parametrize("method", TREES)
def test_trees_leave_the_mean_unchanged(method, plain):
    check_mean(means(method), plain)


@pytest.mark.parametrize("scale", [pytest.param(1.0, marks=LONG), 20.0])
@pytest.mark.parametrize("method", NETWORK_SOURCES)
def test_networks_that_know_nothing_leave_the_mean_unchanged(method, scale, plain, monkeypatch):
    monkeypatch.setattr(sets, "make_source_model", lambda settings: Untrained(settings, scale))
    # By the vertex, or by region.
    check_mean(means(method, network_selection=scale == 1.0 and method != "FLOW"), plain)


@pytest.mark.parametrize("lobes", ["VMF", *(pytest.param(name, marks=LONG) for name in ("NASG", "SG"))])
def test_lobes_are_interchangeable(lobes, plain, monkeypatch):
    monkeypatch.setattr(sets, "make_source_model", lambda settings: Untrained(settings, 4.0))
    check_mean(means("NPM", mixture_lobes=lobes), plain)


@pytest.mark.parametrize("source", ["SDTREE", "NASG", "FLOW"])
def test_any_source_can_be_resampled(source, plain, monkeypatch):
    if source in NETWORK_SOURCES:
        monkeypatch.setattr(sets, "make_source_model", lambda settings: Untrained(settings, 4.0))
    report = render("VMM_RIS", 1, scene=pit_scene, source_field=source, candidate_count=3, **LONGEST).report
    assert report.guiding.candidates_per_vertex == pytest.approx(3.0)
    check_mean(means("VMM_RIS", source_field=source, candidate_count=3), plain)


@pytest.mark.parametrize("method", TREES)
def test_the_image_of_trees_does_not_depend_on_threads(method):
    one, two = (
        render(method, 3, scene=corner_scene, threads=threads, samples=31, guiding_trial=False).passes["Combined"]
        for threads in (1, 2)
    )
    assert np.array_equal(one, two)


@pytest.mark.parametrize("method", ["VMM", "SDTREE"])
def test_compensation_leaves_the_mean_unchanged(method, plain):
    check_mean(means(method, mis_compensation=True), plain)


@pytest.mark.parametrize("method", ["VMM", pytest.param("NPM", marks=LONG)])
@pytest.mark.parametrize("scene", PITS.values(), ids=PITS)
def test_whatever_the_camera_sees_the_mean_is_unchanged(scene, method, monkeypatch):
    """Light and alpha of a transparent film, each within four standard errors."""
    monkeypatch.setattr(
        sets, "make_source_model",
        lambda settings, make=sets.make_source_model: Untrained(settings, 4.0) if method == "NPM" else make(settings),
    )  # fmt: skip

    def means(method, first, **settings):
        renders = [render(method, first + k, scene=scene, film_transparent=True, **settings) for k in range(SEEDS)]
        assert all(found.report.guiding.candidates_per_vertex == (method != "OFF") for found in renders)
        return np.array([found.passes["Combined"].mean(axis=(0, 1), dtype=np.float64) for found in renders])

    settings = LONGEST | {"samples": 63 if method == "NPM" else 31}
    plain, guided = means("OFF", 100, **settings), means(method, 0, learn_guiding_probability=False, **settings)
    error = np.sqrt((guided.var(axis=0, ddof=1) + plain.var(axis=0, ddof=1)) / SEEDS)
    assert (np.abs(guided.mean(axis=0) - plain.mean(axis=0)) < Z_LIMIT * error + 1e-6).all()
    # The test can see a bias of 3%.
    assert (Z_LIMIT * error < 0.03 * plain.mean(axis=0)).all()


def test_compensation_leaves_what_the_bsdf_cannot_do():
    records = allocate_vertex_records(4)
    records.radiance[:] = 2.0
    records.bsdf_pdf[:] = [0.0, 1.0, 3.0, np.nan]
    records.guide_pdf[:] = [1.0, 1.0, 0.0, np.nan]
    learned = compensate(records, 4, 0.5).radiance
    # None of the directions that the BSDF alone proposes; all of those from before there was a guide.
    np.testing.assert_allclose(learned[:, 0], [2.0, 1.0, 0.0, 2.0])
    assert (records.radiance == 2.0).all()


def test_trees_are_used():
    report = render("SDTREE", 1, scene=pit_scene, **LONGEST).report.guiding
    assert report.candidates_per_vertex == 1.0 and "regions" in report.source


@pytest.mark.slow
@pytest.mark.one_of_many
@pytest.mark.parametrize("method", every(NETWORK_SOURCES, 2))
def test_trained_networks_leave_the_mean_unchanged(method, plain):
    require_torch()
    training = {"deterministic": True, "training_steps": 16}
    report = render(method, 1, scene=pit_scene, **training, **LONGEST).report
    assert not [notice for notice in report.notices if "Guiding" in notice.subject]
    assert "snapshots" in report.guiding.source and report.guiding.candidates_per_vertex == 1.0
    check_mean(means(method, **training), plain)


@pytest.mark.slow
def test_the_image_of_a_network_does_not_depend_on_threads():
    require_torch()
    one, two = (
        render(
            "NPM_PRODUCT", 3, scene=corner_scene, threads=threads, samples=31, guiding_trial=False, deterministic=True,
            training_steps=16,
        ).passes["Combined"]
        for threads in (1, 2)
    )
    assert np.array_equal(one, two)


@pytest.mark.parametrize("method", ["NASG", "FLOW"])
def test_the_mixture_field_guides_until_there_is_a_network(method, monkeypatch):
    settings = {"scene": pit_scene, "samples": 15, "guiding_trial": False}
    mixture = render("VMM", 0, **settings).passes["Combined"]
    images = []
    for silence in (99, 3):
        monkeypatch.setattr(sets, "make_source_model", lambda settings, n=silence: Late(settings, 1.0, n))
        images.append(render(method, 0, **settings).passes["Combined"])
    # The methods' kernels are compiled apart and round apart, so that a few paths take another turn.
    same = [np.isclose(image, mixture, rtol=1e-3).all(axis=-1).mean() for image in images]
    assert same[0] > 0.98 and same[1] < 0.5


def test_a_network_that_does_not_pay_is_given_up(monkeypatch):
    """What stood in for it guides again, and is tried in its turn."""
    monkeypatch.setattr(sets, "make_source_model", lambda settings: Late(settings, 20.0, 4))
    settings = {"scene": pit_scene, "samples": 255, "max_bounces": 12, "diffuse_bounces": 12, "deterministic": True}
    result = render("NPM", 0, **settings)
    report = result.report.guiding
    # In the third iteration that compares it must be better than unguided rendering.
    assert 31 <= report.source_stopped_at <= 79
    assert result.guidance.source is None
    assert not report.stopped_at or report.stopped_at > report.source_stopped_at
    assert "did not pay" in " ".join(report.lines)


@pytest.mark.slow
def test_a_worker_that_is_gone_is_named(monkeypatch):
    refuse_workers(monkeypatch)
    report = render("NPM", 1, scene=pit_scene, **LONGEST).report
    assert any(notice.subject == "Guiding / NPM" and "no process" in notice.problem for notice in report.notices)


def test_the_time_is_seen_as_it_is_asked_for():
    """The paper's sizes (Dong et al. 2024, section 5), and smaller ones."""
    from engine.settings import RenderSettings

    paper = RenderSettings(guiding_method="NPM", mixture_preset="PAPER")
    plain = network_design(paper).shape
    planes = network_design(replace(paper, mixture_u="PLANES")).shape
    assert planes.resolutions == plain.resolutions and planes.used_width == plain.used_width + 3 * 8 * 2
    assert planes.plane_resolutions == (8, 16, 32, 64, 128, 256, 512, 1024)
    hashes = network_design(replace(paper, mixture_u="HASH4D")).shape
    assert hashes.hash_resolutions == plain.resolutions and hashes.resolutions == ()
    assert hashes.used_width == plain.used_width and hashes.hash_size == 1 << 22
    for source in ("NPM", "NPM_PRODUCT", "NASG"):
        compact = RenderSettings(guiding_method=source)
        for mixture_u, width in (("NONE", 0), ("FREQUENCY", 8), ("PLANES", 18), ("HASH4D", 8)):
            shape = network_design(replace(compact, mixture_u=mixture_u)).shape
            assert shape.used_width == network_design(compact).shape.used_width + width


def test_sources_that_are_no_networks_have_no_shape():
    from engine.settings import RenderSettings

    settings = RenderSettings(guiding_method="VMM")
    with pytest.raises(ValueError, match="VMM"):
        network_design(settings)
    resampled = network_design(replace(settings, guiding_method="NEURAL_RIS", source_field="NASG"))
    assert resampled.shape.lobe_model == "NASG"


def test_all_mixtures_are_trained_as_asked_for():
    """To compensate for BSDF sampling (Dong et al. 2024, Eq. 12), and to follow strata, whatever they see u by."""
    from engine.settings import U_ENCODINGS, RenderSettings

    for source in (source.name for source in SOURCES.values() if source.is_mixture):
        for mixture_u in U_ENCODINGS:
            plain = RenderSettings(guiding_method=source, mixture_u=mixture_u)
            asked = replace(plain, mis_compensation=True, strata=8, guiding_probability=0.7)
            found, usual = network_design(asked).training, network_design(plain).training
            assert found.mis_compensation and found.follows_u and found.bsdf_share == pytest.approx(0.3)
            assert found.averaging == min(usual.averaging, 0.9)
            assert not usual.mis_compensation and not usual.follows_u
