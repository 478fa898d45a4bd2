# SPDX-License-Identifier: GPL-3.0-or-later
"""A noise threshold: Cycles' rule, the same decisions for any thread count, no visible bias, and why a render ended."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from benchmarks.bias import find_bias
from engine.guiding.models.residual import known_residual, residual_noise
from engine.render.adaptive import ActivePixels, NoiseThreshold, pixel_errors
from engine.render.film import Film
from engine.render.session import Session
from engine.render.tiles import tiles_of
from engine.scene.description import Frame, Light, World
from engine.settings import RenderSettings
from engine.state.film import FilmLayout
from engine.wavefront.accumulate import is_in_half
from tests.helpers.seeded_renders import render
from tests.helpers.small_scenes import corner_scene, floor_scene

SIZE = 24, 20


@pytest.mark.parametrize(("asked", "samples", "threshold", "least", "looks"), [
    (0.01, 4096, 0.01, 64, [80, 96, 112]),
    (0.1, 4096, 0.1, 32, [48, 64, 80]),
    (0.0, 128, 1.0 / 128.0, 69, [80, 96, 112]),
    (0.0, 4096, 0.001, 128, [144, 160, 176]),
    (1.0, 4096, 1.0, 16, [32, 48, 64]),
])  # fmt: skip
def test_threshold_and_least_samples_are_cycles(asked, samples, threshold, least, looks):
    rule = NoiseThreshold.of_settings(RenderSettings(samples=samples, adaptive_threshold=asked))
    assert rule.threshold == pytest.approx(threshold) and rule.least_samples == least
    assert rule.largest_error == pytest.approx(5.0 * threshold)
    found = [rule.next_look(0)]
    while len(found) < 3:
        found.append(rule.next_look(found[-1]))
    assert found == looks


def test_a_user_may_say_how_many_samples_are_the_least():
    rule = NoiseThreshold.of_settings(RenderSettings(adaptive_threshold=0.01, adaptive_min_samples=1))
    assert rule.least_samples == 4 and rule.next_look(0) == 16
    rule = NoiseThreshold.of_settings(RenderSettings(adaptive_threshold=0.01, adaptive_min_samples=200))
    assert rule.least_samples == 200 and rule.next_look(0) == 208


def test_four_samples_in_a_row_have_two_in_the_half():
    found = [bool(is_in_half(sample)) for sample in range(4096)]
    assert found == [bin(sample & 0xAAAAAAAA).count("1") % 2 == 1 for sample in range(4096)]
    assert (np.array(found).reshape(-1, 4).sum(axis=1) == 2).all()


def film_of(mean, half, *, samples=64, shape=SIZE):
    """A film whose pixels have these means, of all samples and of the half."""
    film = Film(*shape, FilmLayout(use_half=True))
    film.sums.count[:] = film.sums.weight[:] = samples
    film.sums.half_weight[:] = samples / 2
    film.sums.radiance[:] = samples * np.asarray(mean)
    film.sums.half[:] = samples / 2 * np.asarray(half)
    return film


@pytest.mark.parametrize(("mean", "half", "exposure", "expected"), [
    ((0.1, 0.1, 0.2), (0.1, 0.1, 0.2), 1.0, 0.0),
    # Below one the root of the brightness, of all channels together.
    ((0.1, 0.2, 0.19), (0.2, 0.1, 0.19), 1.0, 0.2 / (1e-4 + 0.7)),
    ((1.0, 2.0, 1.0), (1.0, 1.0, 1.5), 1.0, 1.5 / (1e-4 + 4.0)),
    ((0.1, 0.2, 0.1), (0.1, 0.1, 0.15), 10.0, 1.5 / (1e-4 + 4.0)),
    ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), 1.0, 0.0),
])  # fmt: skip
def test_errors_are_cycles(mean, half, exposure, expected):
    errors = pixel_errors(film_of(mean, half), np.arange(5), exposure)
    np.testing.assert_allclose(errors, expected, rtol=1e-4, atol=1e-6)


def test_nothing_is_known_of_one_half_alone():
    film = film_of((1.0, 1.0, 1.0), (1.0, 1.0, 1.0))
    film.sums.half_weight[3], film.sums.half_weight[4] = 0.0, film.sums.weight[4]
    errors = pixel_errors(film, np.arange(5), 1.0)
    assert np.isinf(errors[3:]).all() and not errors[:3].any()


def active_of(film, settings=None):
    tiles = tiles_of(Frame(film.width, film.height, (0, 0, film.width, film.height)))
    settings = settings or RenderSettings(samples=4096, use_adaptive_sampling=True)
    return ActivePixels(settings, film, 1.0, tiles)


def pixels_of(active, film):
    """Pixels that go on, bool (height, width); none is in two tiles, and each knows its place in the image."""
    mask = np.zeros((film.height, film.width), np.bool_)
    for pixels, index in active.tiles:
        rows, columns = np.divmod(index, film.width)
        assert np.array_equal(pixels, np.stack([columns, rows], axis=1))
        assert not mask[rows, columns].any()
        mask[rows, columns] = True
    return mask


def test_noisy_pixels_take_their_neighbours_along():
    film = film_of((0.5, 0.5, 0.5), (0.5, 0.5, 0.5))
    active = active_of(film)
    noisy = [(0, 0), (10, 12)]  # row, column
    for row, column in noisy:
        film.sums.half[row * SIZE[0] + column] *= 1.5
    active.look(80)
    expected = np.zeros(SIZE[::-1], np.bool_)
    expected[0:2, 0:2] = expected[9:12, 11:14] = True
    assert np.array_equal(pixels_of(active, film), expected) and active.count == 13
    # What has converged stays so until a neighbour is noisy.
    film.sums.half[:] = film.sums.half_weight[:, None] * 0.5
    film.sums.half[11 * SIZE[0] + 13] *= 1.5
    film.sums.half[18 * SIZE[0] + 2] *= 1.5
    active.look(96)
    expected[:] = False
    expected[10:13, 12:15] = True
    assert np.array_equal(pixels_of(active, film), expected)
    film.sums.half[:] = film.sums.half_weight[:, None] * 0.5
    active.look(112)
    assert active.count == 0 and active.tiles == []


def test_units_are_of_similar_size_however_few_pixels_a_tile_has():
    film = film_of((0.5, 0.5, 0.5), (0.5, 0.5, 0.5), shape=(200, 160))
    rng = np.random.default_rng(1)
    film.sums.half[rng.random(200 * 160) < 0.02] *= 1.5
    active = active_of(film)
    active.look(80)
    sizes = [len(index) for _, index in active.tiles]
    assert 0.1 < active.count / (200 * 160) < 0.25 and sum(sizes) == active.count
    assert pixels_of(active, film).sum() == active.count
    assert max(sizes) <= 128 and min(sizes) >= max(sizes) - 1 > 100


def test_what_is_expected_follows_from_the_errors():
    """Twice the error allowed takes three times as many samples more; nobody gets more than there are."""
    film = film_of((1.0, 1.0, 1.0), (1.0, 1.0, 1.0), samples=100, shape=(3, 1))
    allowed = RenderSettings(samples=1000, use_adaptive_sampling=True)
    active = active_of(film, allowed)
    film.sums.half[:, 0] *= 1.0 + 2.0 * active.rule.largest_error * 3.0
    active.look(100)
    assert active.expected_paths == pytest.approx(3 * 300, rel=1e-3)
    film.sums.half[:, 0] *= 100.0
    active.look(100)
    assert active.expected_paths == 3 * 900


# With a radiance cache


def test_known_light_has_halves_of_its_own():
    """Noise of what measuring paths found is told; light that the cache surely lacks is none."""
    rng = np.random.default_rng(2)
    shape, pixels = (32, 32), 32 * 32
    noise = 0.2 * rng.normal(size=(pixels, 2, 3)).astype(np.float32)
    halves = 0.5 * (1.0 + noise).reshape(pixels, 6)
    variance = np.full(pixels, 0.02, np.float32)
    found = residual_noise(halves, variance, shape)
    np.testing.assert_allclose(found.known, known_residual(halves, variance, shape))
    # Its first half alone says other things, by as much as what is known has noise.
    truth = found.known - 1.0
    assert np.sqrt((found.difference**2).mean()) == pytest.approx(np.sqrt((truth**2).mean()), rel=0.3)
    assert found.lacking.max() < 0.1
    # Half of it in fine detail that two noisy halves do not tell yet: it is missed, and that is known.
    detail = 0.3 * rng.choice([-1.0, 1.0], size=(pixels, 1, 1))
    found = residual_noise(0.5 * (1.0 + detail + 2.0 * noise).reshape(pixels, 6), 4.0 * variance, shape)
    missed = np.sqrt(((found.known - 1.0 - detail[:, 0]) ** 2).mean())
    told = np.sqrt((found.difference**2).mean() + (found.lacking**2).mean())
    assert 0.5 * missed < told < 1.5 * missed


# Renders

#: Lamps that overlap in the lower half of the picture; the upper half has none.
def lamps_scene(size=(48, 32)):
    def lamp(name, x, y, color):
        at = np.eye(4, dtype=np.float32)
        at[:3, 3] = x, y, 2.0
        return Light(name, name, "POINT", at, color, 120.0, radius=0.5)

    lamps = [lamp(f"lamp{k}", 1.6 * (k - 1.5), -2.0, (1.0, 0.3 * k, 1.0 - 0.3 * k)) for k in range(4)]
    scene = floor_scene(lights=lamps, world=World("w", "World", None, (0.05, 0.05, 0.05)), size=size)
    sheet = np.diag([0.02, 0.01, 1.0, 1.0]).astype(np.float32)
    sheet[:3, 3] = 0.0, -1.0, 1.0
    return replace(scene, instances=floor_scene(transforms=[np.eye(4), sheet]).instances)


def counts_of(result):
    return result.passes["Sample Count"][..., 0]


ADAPTIVE = {
    "samples": 256, "use_adaptive_sampling": True, "adaptive_threshold": 0.05, "adaptive_min_samples": 8,
    "passes": ("Combined", "Sample Count"),
}  # fmt: skip


def test_samples_go_where_the_noise_is():
    result = render("OFF", 1, scene=lamps_scene, **ADAPTIVE)
    counts = counts_of(result)
    assert result.report.ended_by == "NOISE_THRESHOLD"
    assert set(np.unique(counts)) <= set(range(16, 257, 16)) and counts.min() == 16 < counts.max()
    assert result.report.sample_count == pytest.approx(counts.mean())
    # Row 0 is at the bottom, where the lamps are.
    assert counts[:16].mean() > 1.5 * counts[24:].mean()
    assert result.report.path_count == counts.sum()


@pytest.mark.parametrize(("method", "cache"), [("OFF", "OFF"), ("VMM", "OFF"), ("OFF", "CONVERGING")])
def test_the_same_pixels_go_on_for_any_thread_count(method, cache):
    results = [
        render(
            method, 3, scene=lambda: corner_scene((70, 40)), threads=threads, radiance_cache=cache,
            **ADAPTIVE | {"adaptive_threshold": 0.008},
        )
        for threads in (1, 3)
    ]  # fmt: skip
    for name in ("Combined", "Sample Count"):
        assert np.array_equal(results[0].passes[name], results[1].passes[name])
    counts = counts_of(results[0])
    assert counts.min() < counts.max()
    assert not any(math.isnan(value) for value in results[0].passes["Combined"].ravel()[:10])


@pytest.mark.parametrize("method", ["VMM", pytest.param("AUTO", marks=pytest.mark.slow)])
def test_guided_renders_stop_at_the_ends_of_iterations(method):
    counts = counts_of(render(method, 2, scene=lamps_scene, **ADAPTIVE))
    assert counts.min() in (15, 16) and counts.min() < counts.max() < 256


@pytest.mark.parametrize("cache", ["FAST", "CONVERGING"])
def test_pixels_with_a_radiance_cache_stop_too(cache):
    result = render(
        "OFF", 1, scene=corner_scene, radiance_cache=cache, **ADAPTIVE | {"adaptive_threshold": 0.01, "samples": 512}
    )
    assert result.report.ended_by == "NOISE_THRESHOLD" and counts_of(result).max() < 512


def test_a_threshold_that_nothing_reaches_changes_no_picture():
    """Half of the samples is kept aside, and all else is as without."""
    asked = {"samples": 20, "threads": 1, "scene": lamps_scene}
    plain, adaptive = (
        render("OFF", 5, use_adaptive_sampling=is_used, adaptive_min_samples=64, **asked) for is_used in (False, True)
    )
    assert np.array_equal(plain.passes["Combined"], adaptive.passes["Combined"])


def ended_by(should_cancel=None, **settings):
    session = Session(RenderSettings(**{"threads": 2, "use_adaptive_sampling": True} | settings))
    session.load(lamps_scene((96, 64)))
    said = []
    result = session.render(on_progress=said.append, should_cancel=should_cancel)
    session.close()
    fractions = [progress.fraction for progress in said]
    assert fractions == sorted(fractions)
    return result.report.ended_by, said[-1]


def test_what_ended_a_render_is_told():
    name, last = ended_by(samples=4096, adaptive_threshold=0.1, adaptive_min_samples=4)
    assert (name, last.message, last.noisy_share) == ("NOISE_THRESHOLD", "Noise threshold reached", 0.0)
    name, last = ended_by(samples=24, adaptive_threshold=1e-6)
    assert (name, last.message, last.sample) == ("SAMPLES", "All samples taken", 24)
    name, last = ended_by(samples=1 << 20, adaptive_threshold=1e-6, time_limit=0.5)
    assert (name, last.message) == ("TIME_LIMIT", "Time limit reached")
    for method in ("OFF", "VMM"):
        assert ended_by(samples=1 << 20, time_limit=0.5, use_adaptive_sampling=False, guiding_method=method)[0] == (
            "TIME_LIMIT"
        )
    asked = iter(range(1 << 20))
    name, last = ended_by(lambda: next(asked) > 20, samples=1 << 20, adaptive_threshold=1e-6)
    assert (name, last.message) == ("CANCEL", "Cancelled")


@pytest.mark.slow
@pytest.mark.parametrize("method", ["OFF", "VMM"])
def test_no_bias_is_seen(method):
    """Significance 1e-4 (`benchmarks.bias`), at Cycles' own least samples."""
    settings = {"scene": lamps_scene, "samples": 512, "passes": ("Combined",)}

    def images(seeds, method=method, **changes):
        return [render(method, seed, **settings | changes).passes["Combined"] for seed in seeds]

    plain = images(range(100, 108), "OFF")
    bias = find_bias(images(range(8), use_adaptive_sampling=True, adaptive_threshold=0.02), plain)
    assert not bias.is_biased and bias.detectable < 0.01, bias
