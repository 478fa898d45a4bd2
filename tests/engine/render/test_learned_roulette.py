# SPDX-License-Identifier: GPL-3.0-or-later
"""Roulette by what surfaces were found to send back: right whatever is said of them, no noisier than by throughput."""

from dataclasses import replace

import numpy as np
import pytest

from engine.guiding.policy.learnables.roulette import RouletteModel
from engine.scene.description import World
from engine.settings import RenderSettings
from tests.helpers.seeded_renders import Z_LIMIT, render, trial_rules, z_score
from tests.helpers.small_scenes import floor_scene, material, pit_scene

pytestmark = pytest.mark.estimator

#: Of a scene in which light that has met five surfaces still counts.
PIT = {"scene": pit_scene, "samples": 63, "max_bounces": 12, "diffuse_bounces": 12}
SEEDS = 6


def images(method, first, count=SEEDS, **settings):
    """float32 (seeds, height, width, 3)"""
    renders = [render(method, first + seed, **PIT | settings) for seed in range(count)]
    return np.stack([result.passes["Combined"][..., :3] for result in renders])


def means(found):
    return found.mean(axis=(1, 2, 3))


@pytest.fixture(scope="module")
def plain():
    return images("OFF", 100)


def distort(monkeypatch, how):
    """Have roulette go by something else than what was learned."""
    learn = RouletteModel.learn

    def distorted(model, *arguments):
        learn(model, *arguments)
        importance = model.field.importance
        importance[:] = how(importance)

    monkeypatch.setattr(RouletteModel, "learn", distorted)


@pytest.mark.parametrize(
    "how",
    [lambda found: found, lambda found: 1000.0 * found, lambda found: np.full_like(found, np.nan)],
    ids=["learned", "thousandfold", "NaN"],
)
def test_the_mean_is_right_whatever_is_expected(how, plain, monkeypatch):
    distort(monkeypatch, how)
    found = means(images("OFF", 0, roulette="LEARNED"))
    assert z_score(found, means(plain)) < Z_LIMIT
    # The test can see a bias of 2%.
    assert z_score(1.02 * found, means(plain)) > Z_LIMIT


def test_the_mean_is_right_where_nothing_is_expected(monkeypatch):
    """One bounce: nine of ten paths end at each surface, and of more bounces there would be noise alone."""
    plain = means(images("OFF", 100, max_bounces=1))
    distort(monkeypatch, np.zeros_like)
    found = means(images("OFF", 0, max_bounces=1, roulette="LEARNED"))
    assert z_score(found, plain) < Z_LIMIT
    assert z_score(1.02 * found, plain) > Z_LIMIT


@pytest.mark.parametrize("method", ["VMM", "AUTO"])
def test_the_mean_is_right_in_guided_renders(method, plain):
    found = means(images(method, 0, roulette="LEARNED"))
    assert z_score(found, means(plain)) < Z_LIMIT


def test_the_variance_is_no_larger_than_by_throughput(plain):
    found = images("OFF", 0, roulette="LEARNED")
    assert found.var(axis=0, ddof=1).mean() < 1.1 * plain.var(axis=0, ddof=1).mean()


def test_what_is_learned_decides():
    """Under a dark sky nothing is worth going on for but what the sun lights."""
    by_throughput, learned = (render("OFF", 1, **PIT, roulette=by).report for by in ("THROUGHPUT", "LEARNED"))
    assert learned.rays["closest"] != by_throughput.rays["closest"]


def test_one_sample_a_pixel_decides_nothing():
    """It has no variance, beside which any path would be worth its cost."""

    def pictures(samples):
        settings = PIT | {"samples": samples}
        return [render("OFF", 1, **settings, roulette=by).passes["Combined"] for by in ("THROUGHPUT", "LEARNED")]

    assert np.array_equal(*pictures(3))
    # Of more samples tasks are others, and so is the order in which a pixel's are added.
    assert np.allclose(*pictures(4), rtol=1e-6, atol=0.0)
    assert not np.allclose(*pictures(8), rtol=1e-3, atol=0.0)


@pytest.mark.parametrize("least", [0.0, 1e9], ids=["guided", "given up"])
def test_automatic_guiding_goes_by_it_whether_it_wins_or_loses(least):
    rules = trial_rules(least, roulette_least_efficiency=0.0)
    settings = PIT | {"samples": 32, "deterministic": True}
    for by in ("AUTO", "THROUGHPUT"):
        guidance = render("AUTO", 1, **settings, roulette=by, rules=rules).guidance
        assert (guidance.field is not None) == (least == 0.0)
        assert (guidance.roulette_field is not None) == (by == "AUTO")


def test_it_is_learned_on_once_guiding_has_lost(monkeypatch):
    """As without guiding: from the first sixteen samples."""

    def large():
        # Guiding is tried on a part of the pixels, and what the others have had judges roulette.
        return pit_scene((64, 64))

    rules = trial_rules(1e9, roulette_least_efficiency=0.0)
    learn, counts = RouletteModel.learn, []

    def counted(model, records, row_count, *others):
        counts.append(row_count)
        learn(model, records, row_count, *others)

    monkeypatch.setattr(RouletteModel, "learn", counted)
    settings = PIT | {"scene": large, "samples": 32, "deterministic": True}
    one, two = (render("AUTO", 1, **settings, threads=threads, rules=rules) for threads in (1, 2))
    assert one.report.guiding.stopped_at == 8
    # After 1, 4, 8 and 16 samples, by either.
    assert len(counts) == 8 and min(counts) > 0
    assert np.array_equal(one.passes["Combined"], two.passes["Combined"])


def test_the_image_does_not_depend_on_threads():
    one, three = (
        render("OFF", 1, **PIT, roulette="LEARNED", threads=threads).passes["Combined"] for threads in (1, 3)
    )
    assert np.array_equal(one, three)


def test_paths_do_not_explode_between_mirrors():
    """Two mirrors that swallow a thousandth, face to face, and room for 128 bounces."""

    def mirrors():
        above = np.diag([1.0, -1.0, -1.0, 1.0]).astype(np.float32)
        above[2, 3] = 12.0
        polished = [material(color=(0.999, 0.999, 0.999), kind="ShaderNodeBsdfGlossy")]
        sky = World("sky", "Sky", None, (1.0, 1.0, 1.0))
        return floor_scene(world=sky, materials=polished, transforms=[np.eye(4), above], size=(16, 16))

    settings = {"scene": mirrors, "samples": 31, "max_bounces": 128, "glossy_bounces": 128}
    by_throughput, learned = (render("OFF", 1, **settings, roulette=by).report for by in ("THROUGHPUT", "LEARNED"))
    assert by_throughput.rays["closest"] > 20 * by_throughput.path_count
    assert learned.rays["closest"] < 1.02 * by_throughput.rays["closest"]


def test_who_asks_for_nothing_learns_nothing():
    settings = RenderSettings(guiding_method="AUTO")
    assert settings.learns_roulette
    for change in (
        {"guiding_method": "OFF"}, {"guiding_method": "VMM"}, {"roulette": "THROUGHPUT"}, {"samples": 8},
        {"use_russian_roulette": False}, {"radiance_cache": "FAST"},
    ):  # fmt: skip
        assert not replace(settings, **change).learns_roulette
    # A cache that may be given up leaves a plain guided render behind.
    assert replace(settings, radiance_cache="CONVERGING").learns_roulette
    assert not RenderSettings(roulette="LEARNED", radiance_cache="CONVERGING").learns_roulette
