# SPDX-License-Identifier: GPL-3.0-or-later
"""A threshold on the denoised picture: when it ends a render, and that this leaves the picture of so many samples."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from engine.denoise import library
from engine.render import denoised_threshold
from engine.render.denoised_threshold import DenoisedThreshold, chosen_cells, display_values, half_pictures
from engine.render.film import Film
from engine.render.session import Session
from engine.settings import RenderSettings
from engine.state.film import FilmLayout
from tests.helpers.small_scenes import corner_scene, floor_scene, material

needs_library = pytest.mark.skipif(bool(library.problem()), reason="no Open Image Denoise here")

PASSES = ("Combined", "Noisy Image", "Sample Count")
SETTINGS = RenderSettings(
    samples=120, threads=2, seed=3, use_denoising=True, denoising_quality="BALANCED", deterministic=True
)


def render(scene=None, stop_at=None, should_cancel=None, **changes):
    session = Session(replace(SETTINGS, **changes))
    session.load(corner_scene() if scene is None else scene)
    result = session.render(passes=PASSES, samples=stop_at, should_cancel=should_cancel)
    session.close()
    return result


def is_same(one, other):
    return all(np.array_equal(one.passes[name], other.passes[name]) for name in PASSES)


def test_display_values_are_srgb_and_go_on_above_white():
    shown = display_values(np.array([-1.0, 0.0, 0.001, 0.2140411, 1.0, np.e, np.inf, np.nan], np.float32))
    expected = [0.0, 0.0, 0.01292, 0.5, 1.0, 1.0 + 1.055 / 2.4, 1.0 + 1.055 / 2.4 * np.log(1e18), 0.0]
    np.testing.assert_allclose(shown, expected, rtol=1e-5)
    # No step, nor a bend, at white.
    slope = np.diff(display_values(np.array([0.999, 1.0, 1.001], np.float32)).astype(np.float64))
    assert slope[0] == pytest.approx(slope[1], rel=1e-2)


def film_of(first, second, *, weights=(3.0, 1.0), size=(3, 2)):
    """A film whose halves have these means, by samples of these weights in all."""
    film = Film(*size, FilmLayout(use_half=True))
    film.sums.count[:] = 8
    film.sums.weight[:], film.sums.half_weight[:] = sum(weights), weights[0]
    film.sums.half[:] = weights[0] * np.float32(first)
    film.sums.radiance[:] = film.sums.half + weights[1] * np.float32(second)
    return film


def test_halves_are_means_of_disjoint_samples():
    film = film_of((0.5, 1.0, 0.0), (2.0, 4.0, 0.5))
    picture = film.passes({"Combined"}, exposure=2.0)["Combined"]
    first, second = half_pictures(film, picture, 2.0)
    np.testing.assert_allclose(first, np.broadcast_to([1.0, 2.0, 0.0], first.shape), atol=1e-6)
    np.testing.assert_allclose(second, np.broadcast_to([4.0, 8.0, 1.0], second.shape), atol=1e-6)
    # What radiance has not is in both.
    first, second = half_pictures(film, picture + np.float32(0.25), 2.0)
    assert first[0, 0, 0] == pytest.approx(1.25) and second[0, 0, 0] == pytest.approx(4.25)


def test_a_pixel_with_one_half_alone_is_the_same_in_both():
    film = film_of((0.5, 1.0, 0.0), (2.0, 4.0, 0.5))
    film.sums.half_weight[1], film.sums.half_weight[2] = 0.0, film.sums.weight[2]
    picture = film.passes({"Combined"}, exposure=1.0)["Combined"]
    first, second = half_pictures(film, picture, 1.0)
    assert np.array_equal(first[0, 1:], second[0, 1:]) and not np.array_equal(first[0, 0], second[0, 0])
    assert np.array_equal(first[0, 1:], picture[0, 1:, :3])


@needs_library
@pytest.mark.parametrize(("method", "cache"), [("OFF", "OFF"), ("VMM", "OFF"), ("VMM", "CONVERGING")])
def test_the_picture_is_that_of_a_render_of_so_many_samples(method, cache):
    """However many threads, and whether or not somebody looks at it."""
    how = {"guiding_method": method, "radiance_cache": cache, "samples": 200}
    lax, strict = (render(denoised_threshold=threshold, **how) for threshold in (0.05, 0.004))
    counts = [one.report.sample_count for one in (lax, strict)]
    assert lax.report.ended_by == strict.report.ended_by == "DENOISED_THRESHOLD"
    assert 16 <= counts[0] < counts[1] < 200
    for result, threshold, count in ((lax, 0.05, counts[0]), (strict, 0.004, counts[1])):
        report = result.report
        assert 0.0 < report.denoised_error < threshold and report.denoised_look == count
        assert f"stopped at sample {count:.0f}, error about" in report.denoised_sentence
    other = render(denoised_threshold=0.004, **how | {"threads": 1})
    assert is_same(strict, other) and strict.report.denoised_error == other.report.denoised_error
    assert is_same(strict, render(stop_at=round(counts[1]), **how))


@needs_library
def test_it_goes_with_a_noise_threshold():
    how = {"use_adaptive_sampling": True, "adaptive_threshold": 0.004, "adaptive_min_samples": 20, "samples": 400}
    both = render(denoised_threshold=0.004, **how)
    assert both.report.ended_by == "DENOISED_THRESHOLD"
    counts = both.passes["Sample Count"]
    assert counts.min() < counts.max() == both.report.denoised_look
    assert is_same(both, render(denoised_threshold=0.004, **how | {"threads": 1}))


@needs_library
def test_a_scene_without_noise_ends_at_the_first_look():
    glow = material("Glow", (0.4, 0.3, 0.2), "ShaderNodeEmission")
    report = render(floor_scene(materials=[glow]), denoised_threshold=1e-5).report
    assert (report.ended_by, report.denoised_look) == ("DENOISED_THRESHOLD", 17)
    assert report.sample_count == 17 and report.denoised_error < 1e-5


@needs_library
def test_looks_are_ever_rarer(monkeypatch):
    looks = []
    monkeypatch.setattr(DenoisedThreshold, "estimate", lambda self, samples: looks.append(samples) or 1.0)
    seen = []
    look = DenoisedThreshold.look
    monkeypatch.setattr(DenoisedThreshold, "look", lambda self, samples: seen.append(samples) or look(self, samples))
    for how in ({}, {"guiding_method": "VMM"}, {"use_adaptive_sampling": True, "adaptive_threshold": 1e-6}):
        seen.clear()
        report = render(denoised_threshold=0.5, samples=150, **how).report
        assert report.ended_by == "SAMPLES" and report.denoised_sentence.startswith("denoised picture: last looked at")
        assert 16 <= seen[0] <= 17 and 4 <= len(seen) <= 6
        assert all(later >= 1.5 * earlier for earlier, later in pairwise(seen))
    assert len(looks) >= 12


@needs_library
def test_without_it_nothing_is_kept_or_looked_at(monkeypatch):
    made = []
    monkeypatch.setattr(denoised_threshold, "Denoising", lambda *_: made.append(1))
    films = []
    monkeypatch.setattr(Film, "merge", lambda self, *_: films.append(self))
    render(samples=2)
    assert not made and len(films[0].sums.half) == len(films[0].sums.half_weight) == 0


def test_it_is_said_where_nothing_is_denoised(monkeypatch):
    result = render(samples=2, use_denoising=False, denoised_threshold=0.5)
    said = [(notice.subject, notice.problem) for notice in result.report.notices]
    assert said == [("Denoised Noise", "nothing is denoised: Denoise is off")]
    assert result.report.ended_by == "SAMPLES" and not result.report.denoised_sentence
    monkeypatch.setattr(library, "problem", lambda: "gone: nothing there")
    result = render(samples=2, denoised_threshold=0.5)
    assert ("Denoised Noise", "there is no denoiser") in [(one.subject, one.problem) for one in result.report.notices]


@needs_library
def test_a_look_that_fails_is_said_and_the_render_goes_on(monkeypatch):
    def fail(*_, **__):
        raise MemoryError

    monkeypatch.setattr(denoised_threshold, "half_pictures", fail)
    result = render(denoised_threshold=0.5, samples=40)
    assert result.report.ended_by == "SAMPLES" and result.report.sample_count == 40
    assert [(one.subject, one.problem) for one in result.report.notices] == [("Denoised Noise", "out of memory")]


@needs_library
def test_a_cancel_ends_a_look(monkeypatch):
    is_looking = []
    estimate = DenoisedThreshold.estimate

    def slow(self, samples):
        is_looking.append(1)
        while not self._is_stopped.wait(0.01):
            pass
        return estimate(self, samples)

    monkeypatch.setattr(DenoisedThreshold, "estimate", slow)
    result = render(denoised_threshold=0.5, should_cancel=lambda: bool(is_looking))
    assert result.report.cancelled and result.report.denoised_error is None


def test_chosen_cells_stand_for_the_whole_picture():
    random = np.random.default_rng(5)
    noise = random.random((500, 900)) ** 4
    noise[:, 600:] *= 30.0
    noise[:250, :300] = 0.0
    # Denoising leaves other shares of the noise in other places.
    left = noise * np.linspace(0.02, 0.06, 900)
    found = []
    for look in range(40):
        cells = chosen_cells(noise, look)
        assert len(cells) <= 5 and all(noise[cell].any() for cell, _ in cells)
        assert sum(factor * noise[cell].sum() for cell, factor in cells) == pytest.approx(noise.mean())
        found.append(sum(factor * left[cell].sum() for cell, factor in cells))
    assert np.mean(found) == pytest.approx(left.mean(), rel=0.02)
    assert np.std(found) < 0.1 * left.mean()
    whole = [((slice(0, 100), slice(0, 200)), pytest.approx(1.0 / 20000.0))]
    assert chosen_cells(np.ones((100, 200)), 3) == whole
    assert len(chosen_cells(np.zeros((500, 900)), 3)) == 1
