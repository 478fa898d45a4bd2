# SPDX-License-Identifier: GPL-3.0-or-later
"""Paths that end in the radiance cache: right on average with what measuring paths find, whatever the cells say."""

import math
from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from engine.guiding.fields.cells.field import empty_cells
from engine.guiding.policy import trial
from engine.guiding.policy.learnables.cache import LearnedCache
from engine.render import film
from engine.scene.description import World
from tests.helpers.seeded_renders import Z_LIMIT, render, z_score
from tests.helpers.small_scenes import corner_scene, floor_scene, material, pit_scene

pytestmark = pytest.mark.estimator

#: Of a scene in which paths are long; limits that they often meet would keep them from ending.
ENDLESS = {"scene": pit_scene, "samples": 63, "max_bounces": 96, "diffuse_bounces": 96}
SEEDS = 4


def image_mean(method, seed, **settings):
    return render(method, seed, **ENDLESS | settings).passes["Combined"][..., :3].mean()


def means(method, first=0, count=SEEDS, **settings):
    return np.array([image_mean(method, first + seed, **settings) for seed in range(count)])


@pytest.fixture(scope="module")
def plain():
    return means("OFF", 100)


def pit_with(strength):
    """The pit with lamps of so many times their strength."""
    scene = pit_scene()
    return replace(scene, lights=[replace(light, energy=strength * light.energy) for light in scene.lights])


def distort(monkeypatch, how):
    """Have paths end in cells that say something else than they have learned."""
    complete = LearnedCache.complete

    def distorted(cache, guidance, *known):
        guidance = complete(cache, guidance, *known)
        cells = guidance.cells
        if cells is None:
            return guidance
        wrong = empty_cells(float(cells.size[0]), len(cells.tag))
        wrong.tag[:], wrong.sums[:] = cells.tag, cells.sums
        wrong.sums[:, :3] = how(cells.sums[:, :3])
        return guidance.with_cells(wrong, guidance.measure_threshold)

    monkeypatch.setattr(LearnedCache, "complete", distorted)


def test_paths_end_and_rays_are_saved():
    without, cached = (render("OFF", 1, **ENDLESS, radiance_cache=cache).report for cache in ("OFF", "FAST"))
    assert sum(without.cached_shares) == 0.0 and sum(cached.cached_shares) > 0.5
    first, second, later = cached.cached_shares
    assert first > second > 0.0 and later > 0.0
    assert cached.rays["closest"] < 0.8 * without.rays["closest"]
    assert any("radiance cache" in line for line in cached.guiding.lines)


@pytest.mark.parametrize(
    ("method", "cache"), [("OFF", "FAST"), ("OFF", "CONVERGING"), ("VMM", "FAST"), ("TABLE_RIS", "CONVERGING")]
)
def test_the_mean_is_right(method, cache, plain):
    """FAST has the right energy too: cells are means of whole paths."""
    settings = {} if method == "OFF" else {"guiding_trial": False}
    # A cached image has the noise of its cells all over: 0.7% of the mean from seed to seed.
    cached = means(method, count=3 * SEEDS, radiance_cache=cache, **settings)
    assert cached.mean() == pytest.approx(plain.mean(), rel=0.01)


@pytest.mark.parametrize("cache", ["FAST", "CONVERGING"])
def test_lamps_of_negative_strength_take_light(cache):
    """As much as the same lamps bring otherwise, to the last number."""
    brought, taken = (
        render("OFF", 1, **ENDLESS | {"scene": partial(pit_with, strength)}, radiance_cache=cache)
        for strength in (1.0, -1.0)
    )
    assert sum(taken.report.cached_shares) == pytest.approx(sum(brought.report.cached_shares), rel=0.01)
    light = brought.passes["Combined"][..., :3]
    assert light.mean() > 0.01
    np.testing.assert_allclose(taken.passes["Combined"][..., :3], -light, rtol=1e-3, atol=1e-4)


@pytest.mark.parametrize(
    "how", [np.zeros_like, lambda sums: 2.0 * sums, lambda sums: np.where(sums > 0.0, np.nan, sums)],
    ids=["zero", "twice", "NaN"],
)  # fmt: skip
def test_the_mean_is_right_whatever_cells_say(how, plain, monkeypatch):
    distort(monkeypatch, how)
    cached = means("OFF", radiance_cache="CONVERGING")
    assert z_score(cached, plain) < Z_LIMIT
    # The test can see a bias of 5%.
    assert z_score(1.05 * cached, plain) > Z_LIMIT


def test_a_wrong_cache_shows_without_measuring_and_is_mended_with_it(plain, monkeypatch):
    distort(monkeypatch, lambda sums: 2.0 * sums)
    wrong = means("OFF", radiance_cache="FAST").mean()
    mended = means("OFF", radiance_cache="CONVERGING").mean()
    assert wrong > 1.05 * plain.mean()
    assert abs(mended - plain.mean()) < 0.2 * abs(wrong - plain.mean())


def test_a_gross_lie_is_given_up_where_paths_have_little_noise(monkeypatch):
    """Twice the truth on a sunlit wall, where hardly anything else than the lie makes the image wrong."""
    distort(monkeypatch, lambda sums: 2.0 * sums)
    settings = ENDLESS | {"scene": corner_scene}
    report = render("OFF", 1, **settings, radiance_cache="CONVERGING").report
    assert 0 < report.guiding.cache_stopped_at <= 47


@pytest.mark.parametrize("albedo", [0.5, 0.9, 0.99])
def test_no_energy_is_lost_or_made_under_a_white_sky(albedo):
    """A floor and a wall, each of which sees the other and the sky."""

    def furnace():
        sky = World("sky", "Sky", None, (1.0, 1.0, 1.0))
        return replace(corner_scene(), lights=[], materials=[material(color=(albedo,) * 3)], world=sky)

    settings = ENDLESS | {"scene": furnace}
    plain = np.array([image_mean("OFF", seed, **settings) for seed in range(SEEDS)])
    cached = np.array([image_mean("OFF", 10 + seed, radiance_cache="FAST", **settings) for seed in range(SEEDS)])
    assert render("OFF", 0, **settings, radiance_cache="FAST").report.cached_shares[0] > 0.05
    assert z_score(cached, plain) < Z_LIMIT
    assert cached.mean() == pytest.approx(plain.mean(), rel=0.003)


@pytest.mark.parametrize("method", ["OFF", "VMM"])
def test_the_image_is_the_same_for_any_number_of_threads(method):
    images = [
        render(
            method, 3, scene=lambda: corner_scene((70, 40)), samples=31, radiance_cache="CONVERGING", threads=threads
        ).passes["Combined"]
        for threads in (1, 2)
    ]
    np.testing.assert_array_equal(*images)


def test_variances_are_those_of_cached_samples():
    """About their own mean, not about the mean with what they lack."""
    layout = film.FilmLayout(use_residual=True)
    image = film.Film(1, 1, layout)
    tile = film.allocate_tile(1, 3, layout)
    tile.radiance[:], tile.square[:], tile.count[:], tile.residual[:] = 20.0, 50.0, 10, 50.0
    image.merge(np.zeros(1, np.int64), tile)
    passes = image.passes({"Variance"}, exposure=1.0)
    assert (passes["Combined"][..., :3] > 5.0).all()
    np.testing.assert_allclose(passes["Variance"], (5.0 - 2.0**2) / 9, rtol=1e-5)


def test_surfaces_that_the_camera_sees_end_no_paths():
    """A floor and nothing else: every path scatters at what the camera sees, and leaves."""
    lone = lambda: floor_scene(size=(16, 12))  # noqa: E731
    report = render("OFF", 1, scene=lone, samples=31, radiance_cache="FAST").report
    assert report.cached_shares == (0.0, 0.0, 0.0)


def test_what_is_seen_in_gloss_ends_no_paths():
    """Reflections stay sharp: no path ends that no diffuse lobe has sent on."""
    glossy = material(color=(0.8, 0.8, 0.8), kind="ShaderNodeBsdfGlossy")
    glossy.graph.nodes[0].inputs["Roughness"] = 0.4
    scene = lambda: replace(corner_scene((16, 12)), materials=[glossy])  # noqa: E731
    assert render("OFF", 1, scene=scene, samples=31, radiance_cache="FAST").report.cached_shares == (0.0, 0.0, 0.0)


def test_a_cache_that_lies_is_given_up(monkeypatch):
    """And said to be; one that does not is kept, and what it is off by is told."""
    kept = render("OFF", 1, **ENDLESS, radiance_cache="CONVERGING").report.guiding
    assert not kept.cache_stopped_at and 0.0 <= kept.cache_bias < 0.1
    assert "did not know" in kept.lines[-1]
    distort(monkeypatch, lambda sums: 3.0 * sums)
    given_up = render("OFF", 1, **ENDLESS, radiance_cache="CONVERGING").report.guiding
    assert 0 < given_up.cache_stopped_at < ENDLESS["samples"]
    assert "given up" in given_up.lines[-1]


@pytest.mark.slow
def test_a_guided_render_that_has_given_its_cache_up_tries_learned_roulette(monkeypatch):
    distort(monkeypatch, lambda sums: 3.0 * sums)
    # Guiding pays here, or it does not, by what the clock says.
    monkeypatch.setattr(trial, "least_efficiency", lambda *facts, **how: math.inf)
    settings = ENDLESS | {"samples": 127, "max_bounces": 12, "diffuse_bounces": 12}
    report = render("AUTO", 1, **settings, radiance_cache="CONVERGING").report.guiding
    assert report.cache_stopped_at and report.stopped_at
    assert any("learned roulette over OFF" in trial for trial in report.trials)


@pytest.mark.slow
def test_the_error_falls_with_the_samples_where_the_cache_lies(monkeypatch):
    """By a fifth, everywhere: never far from the error of unguided rendering, and ever less."""
    distort(monkeypatch, lambda sums: 1.2 * sums)

    def images(samples, seeds, cache):
        settings = ENDLESS | {"samples": samples}
        renders = (render("OFF", seed, **settings, radiance_cache=cache) for seed in seeds)
        return [result.passes["Combined"][..., :3] for result in renders]

    (reference,) = images(8192, (50,), "OFF")
    errors = {}
    for samples in (16, 128, 1024):
        errors[samples] = {
            cache: np.mean([((image - reference) ** 2).mean() for image in images(samples, range(3), cache)])
            for cache in ("OFF", "CONVERGING")
        }
    for samples, error in errors.items():
        assert error["CONVERGING"] < 2.0 * error["OFF"], (samples, errors)
    for samples in (128, 1024):
        assert errors[samples]["CONVERGING"] < 0.4 * errors[samples // 8]["CONVERGING"], errors
