# SPDX-License-Identifier: GPL-3.0-or-later
"""Strata of time: what is planned, what the film makes of them, and that the image is whole however a render ends."""

from __future__ import annotations

import time
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from benchmarks.bias import find_bias
from engine.guiding.policy import sets
from engine.guiding.policy.rules import RULES, Rules
from engine.guiding.records.training_rows import ROW_U
from engine.kernels.rng import SET_TIME, pixel_hash, sample_4d
from engine.render import resolution
from engine.render.session import Session
from engine.render.strata import StrataFilm, StrataSchedule, strata_count
from engine.runtime.jit import kernel
from engine.settings import RenderSettings
from engine.state.film import FilmLayout, FilmTile, allocate_tile
from engine.state.unit import ALL_STRATA
from tests.helpers.seeded_renders import render_seeds
from tests.helpers.small_scenes import emitter_scene
from tests.helpers.training import require_torch
from tests.helpers.untrained_networks import Untrained

pytestmark = pytest.mark.estimator

PROGRESSIVE = {"guiding_method": "NPM", "mixture_u": "FREQUENCY", "guiding_trial": False}


# Plans


def planned(samples, count, time_limit=0.0, seconds_per_sample=0.0):
    """(stratum, first sample, samples) of all iterations; samples take as long as said."""
    schedule = StrataSchedule(RenderSettings(samples=samples, time_limit=time_limit), count)
    steps, sample, seconds = [], 0, 0.0
    while not time_limit or seconds < time_limit:
        step = schedule.next(sample, seconds)
        if step is None:
            break
        steps.append((step[0], sample, step[1]))
        sample += step[1]
        seconds += step[1] * seconds_per_sample
    return steps


@pytest.mark.parametrize("samples, count", [(16, 2), (256, 8), (257, 8), (511, 64), (512, 64), (4096, 64)])
def test_samples_are_divided_among_the_strata(samples, count):
    steps = planned(samples, count)
    order = [step[0] for step in steps]
    assert order == sorted(order) and set(order) == {ALL_STRATA, *range(count)}
    of_stratum = {k: sum(length for stratum, _, length in steps if stratum == k) for k in order}
    assert count <= of_stratum[ALL_STRATA] <= max(count, samples // 8)
    assert sum(of_stratum.values()) == samples
    shares = [of_stratum[k] for k in range(count)]
    assert max(shares) - min(shares) <= 1


@pytest.mark.parametrize("seconds_per_sample", [0.003, 0.05, 0.11])
def test_time_is_divided_among_the_strata(seconds_per_sample):
    limit = 10.0
    steps = planned(1 << 20, 8, limit, seconds_per_sample)
    samples = np.zeros(8)
    for stratum, _, length in steps:
        if stratum != ALL_STRATA:
            samples[stratum] += length
    seconds = samples * seconds_per_sample
    # The last one is cut short by the end; each may be an iteration off.
    assert np.abs(seconds - (limit - seconds_per_sample * steps[0][2]) / 8).max() < 0.3 + 8 * seconds_per_sample
    assert (samples > 0).all()


def test_no_more_strata_than_samples_and_memory_are_worth():
    settings = RenderSettings(samples=512, strata=64, **PROGRESSIVE)
    assert strata_count(settings, 40 * 1000) == 64
    assert strata_count(replace(settings, samples=100), 40 * 1000) == 8
    assert strata_count(replace(settings, samples=1), 40 * 1000) == 1
    assert strata_count(replace(settings, strata=7), 40 * 1000) == 4
    assert strata_count(settings, 40 * 8_300_000) == 2
    for off in ({"strata": 0}, {"strata": 1}, {"guiding_method": "OFF"}, {"guiding_method": "VMM"}):
        assert strata_count(replace(settings, **off), 40 * 1000) == 1


@kernel
def _times(rng, count, out):
    for sample in range(count):
        u, _, _, _ = sample_4d(rng, sample, SET_TIME)
        out[sample] = u


@pytest.mark.parametrize("count", [2, 8, 64])
def test_the_first_samples_of_a_pixel_lie_in_all_strata(count):
    """Why strata are a power of two; and which comes first is even chance."""
    times = np.zeros(count, np.float32)
    first = np.zeros(count, int)
    for pixel in range(2000):
        _times(pixel_hash(3, 8 * pixel, 0), count, times)
        index = (times * count).astype(int)
        assert len(set(index)) == count
        first[index[0]] += 1
    assert first.min() > 0.5 * 2000 / count - 10


# The film


def random_tile(rng, rows):
    tile = allocate_tile(rows, 3, FilmLayout(use_features=True, use_half=True))
    for column in tile:
        column[...] = rng.uniform(0.5, 2.0, column.shape)
    tile.count[:] = rng.integers(1, 5, rows)
    return tile


def test_the_film_is_the_mean_of_the_strata():
    rng = np.random.default_rng(1)
    film = StrataFilm(5, 4, 4, FilmLayout(use_features=True, use_half=True))
    pixels = np.array([3, 19, 7])
    tile = random_tile(rng, 12)
    by_pixel = film.merge_stratum(pixels, tile, 0.5, ALL_STRATA)
    np.testing.assert_allclose(by_pixel.radiance, tile.radiance.reshape(3, 4, 3).sum(axis=1), rtol=1e-6)
    late = random_tile(rng, 8)
    film.merge_stratum(pixels, late, 1.0, 2)

    def mean(name, counts="count"):
        values = getattr(tile, name).reshape(3, 4, -1) * 0.5
        weights = getattr(tile, counts).reshape(3, 4, 1) * 0.5
        values[:, 2] += getattr(late, name).reshape(8, -1)[:3]
        weights[:, 2] += getattr(late, counts)[:3, None]
        return (values / weights).mean(axis=1)

    for name in ("radiance", "square", "alpha", "features"):
        found = getattr(film.sums, name)[pixels].reshape(3, -1) / film.sums.weight[pixels, None]
        np.testing.assert_allclose(found, mean(name), rtol=1e-5)
    half = film.sums.half[pixels] / film.sums.half_weight[pixels, None]
    np.testing.assert_allclose(half, mean("half", "half_weight"), rtol=1e-5)
    assert np.array_equal(film.sums.count[pixels], tile.count.reshape(3, 4).sum(axis=1) + late.count[:3])
    assert film.sums.weight.sum() == pytest.approx(film.sums.weight[pixels].sum())
    np.testing.assert_array_equal(film.sums.points[pixels], tile.points.reshape(3, 4, -1)[:, 0])
    images = film.passes({"Variance", "Normal"}, exposure=1.0)
    assert all(np.isfinite(image).all() for image in images.values())


def test_strata_without_samples_are_left_out():
    film = StrataFilm(2, 1, 4)
    tile: FilmTile = allocate_tile(8, 3)
    tile.radiance[:, 0] = np.arange(8)
    tile.count[:] = 0, 1, 1, 0, 0, 0, 0, 1
    tile.radiance[tile.count == 0] = 0.0
    film.merge_stratum(np.array([0, 1]), tile, 1.0, ALL_STRATA)
    assert film.passes(set(), exposure=1.0)["Combined"][0, :, 0].tolist() == [1.5, 7.0]


# Renders


#: Of renders that end at once each costs what it takes to begin one: their pictures are larger, and fewer.
SMALL, LARGE = (16, 12), (64, 48)


@cache
def reference(size=SMALL):
    """As many samples whatever the size."""
    pixels = np.prod(size) // np.prod(SMALL)
    return render_seeds(emitter_scene(size), range(10, 14), samples=512 // pixels)


@pytest.fixture
def untrained(monkeypatch):
    """A network with parameters drawn at random: no other is as wrong."""
    monkeypatch.setattr(sets, "make_source_model", lambda settings: Untrained(settings, 4.0))


@pytest.mark.parametrize("count", [1, 8, 64])
def test_strata_leave_the_mean_unchanged(count, untrained):
    images = render_seeds(emitter_scene(), range(2), **PROGRESSIVE, strata=count, samples=512)
    bias = find_bias(images, reference())
    assert not bias.is_biased and bias.detectable < 0.03, bias


@pytest.mark.parametrize("end", [1, 5, 100, 250])
def test_the_image_is_whole_however_it_ends(end, untrained, monkeypatch):
    """In the first pass, and after some of the strata."""
    following = StrataSchedule.next
    monkeypatch.setattr(
        StrataSchedule, "next", lambda self, sample, seconds: following(self, sample, seconds) if sample < end else None
    )
    # A small picture has four blocks: of two pictures too little is known about the noise.
    size, seeds = (LARGE, range(max(8, 40 // end))) if end < 8 else (SMALL, range(max(4, 600 // end)))
    images = render_seeds(emitter_scene(size), seeds, **PROGRESSIVE, strata=8, samples=512)
    if end < 8:
        images = [np.mean(images[k::8], axis=0) for k in range(8)]
    bias = find_bias(images, reference(size))
    assert not bias.is_biased and bias.detectable < 0.06, bias


def test_what_is_not_whole_would_be_seen(untrained, monkeypatch):
    """The last test can fail: if samples counted the same whatever their stratum, it would."""
    following = StrataSchedule.next
    monkeypatch.setattr(
        StrataSchedule, "next", lambda self, sample, seconds: following(self, sample, seconds) if sample < 250 else None
    )
    merge_stratum = StrataFilm.merge_stratum

    def plain(film, pixels, tile, weight, stratum):
        aside = StrataFilm(film.width, film.height, 8, film.layout)
        summed = merge_stratum(aside, pixels, tile, weight, stratum)
        film.merge(pixels, summed, weight)
        return summed

    monkeypatch.setattr(StrataFilm, "merge_stratum", plain)
    images = render_seeds(emitter_scene(), range(2), **PROGRESSIVE, strata=8, samples=512)
    assert find_bias(images, reference()).is_biased


def test_strata_of_no_length(untrained):
    """A shutter that is open for a moment only: many strata are the same time, and one spans all the others."""
    curve = np.zeros(65, np.float32)
    curve[40] = 1.0
    description = replace(emitter_scene(), shutter_curve=curve)
    images = render_seeds(description, range(2), **PROGRESSIVE, strata=16, samples=512)
    bias = find_bias(images, render_seeds(description, range(10, 14), samples=512))
    assert not bias.is_biased and bias.detectable < 0.03, bias


def test_guiding_given_up_goes_on_in_all_strata(untrained):
    rules = Rules(least_efficiency=dict.fromkeys(RULES.least_efficiency, 1e9))
    settings = PROGRESSIVE | {"guiding_trial": True}
    images = render_seeds(emitter_scene(), range(2), rules, **settings, strata=8, samples=512)
    bias = find_bias(images, reference())
    assert not bias.is_biased and bias.detectable < 0.03, bias


def test_a_time_limit_is_kept_and_the_image_is_whole(untrained):
    scene = emitter_scene()
    images = []
    for seed in range(2):
        settings = RenderSettings(
            samples=1 << 20, time_limit=1.0, threads=1, seed=seed, strata=8, **PROGRESSIVE
        )
        job = Session(settings)
        job.load(scene)
        started = time.process_time()
        result = job.render()
        assert result.report.ended_by == "TIME_LIMIT" and time.process_time() - started < 2.0
        job.close()
        images.append(result.passes["Combined"][..., :3])
    bias = find_bias(images, reference())
    assert not bias.is_biased, bias


@pytest.mark.parametrize("samples", [1, 3])
def test_more_strata_than_samples_are_none(samples, untrained):
    images = [
        render_seeds(emitter_scene(), [1], **PROGRESSIVE, strata=count, samples=samples)[0] for count in (0, 64)
    ]
    assert np.isfinite(images[0]).all() and np.array_equal(*images)


@pytest.mark.parametrize("is_moving", [True, False])
def test_only_what_moves_has_strata(is_moving, untrained, monkeypatch):
    found = []
    monkeypatch.setattr(resolution, "strata_count", lambda *given: found.append(strata_count(*given)) or found[-1])
    description = emitter_scene()
    if not is_moving:
        description.instances.motion.clear()
        description.meshes[1].motion_vertices = None
    settings = PROGRESSIVE | {"samples": 32}
    plain, asked = (render_seeds(description, [1], **settings, strata=count)[0] for count in (0, 4))
    assert found == [1, 4 if is_moving else 1] and np.array_equal(plain, asked) != is_moving


# What is learned


def test_rows_of_other_strata_are_forgotten():
    require_torch()
    from engine.guiding.neural.worker.mixture_training import MixtureTraining
    from tests.helpers.analytic_fields import BOUNDS, NPM, rows_of, settings_of

    training = MixtureTraining(NPM, settings_of(NPM, follows_u=True), 1, BOUNDS)
    for low, high in ((0.0, 1.0), (0.0, 1.0), (0.25, 0.375), (0.25, 0.375), (0.625, 0.75)):
        rows = rows_of(2000, 3)
        rows[:, ROW_U] = np.random.default_rng(4).uniform(low, high, 2000)
        training.add(rows)
        for window in (training.window, training.validation):
            held = window.take(np.arange(window.count))[:, ROW_U]
            # The strata beside it are kept.
            assert held.min() >= low - 0.13 and held.max() <= high + 0.13
        training.step()
    assert training.row_count > 1900


def test_rows_of_other_wavelengths_are_forgotten_in_every_piece():
    require_torch()
    from engine.guiding.neural.worker.mixture_training import MixtureTraining
    from tests.helpers.analytic_fields import BOUNDS, NPM, rows_of, settings_of

    training = MixtureTraining(NPM, settings_of(NPM, follows_u=True, u_pieces=4), 1, BOUNDS)
    rng = np.random.default_rng(4)
    for low, high in ((0.0, 1.0), (0.5, 0.625)):
        rows = rows_of(2000, 3)
        rows[:, ROW_U] = (rng.integers(0, 4, 2000) + rng.uniform(low, high, 2000)) / 4.0
        training.add(rows)
    held = 4.0 * training.window.take(np.arange(training.row_count))[:, ROW_U]
    assert set(held.astype(int)) == {0, 1, 2, 3}
    within = held % 1.0
    assert within.min() >= 0.37 and within.max() <= 0.76 and len(within) > 2000
