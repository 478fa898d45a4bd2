# SPDX-License-Identifier: GPL-3.0-or-later
"""What of a render's settings counts in a scene, and which notices say why the rest does not."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import pytest

from engine.accuracy import LEAST_CACHED_SAMPLES
from engine.guiding.policy.request import NOTHING_ASKED, LearningRequest
from engine.render.resolution import resolve
from engine.render.strata import StrataFilm
from engine.scene.description import Frame
from engine.scene.fast_gi import FastGi
from engine.settings import RenderSettings

COMBINED = frozenset({"Combined"})
CACHED = RenderSettings(radiance_cache="CONVERGING")
GUIDED = RenderSettings(guiding_method="AUTO", seed=1)


def scene_of(*, moves=False, disperses=False, groups=(), catches=False, media=False, fast_gi=None):
    description = SimpleNamespace(
        is_moving=moves, has_dispersion=disperses, light_groups=groups, passes=None,
        frame=Frame(96, 64, (0, 0, 96, 64)), fast_gi=fast_gi or FastGi(),
    )
    return SimpleNamespace(
        description=description, has_catchers=catches, media=SimpleNamespace(is_used=media, varies=False)
    )


def resolved(settings, scene, passes=COMBINED, learning=NOTHING_ASKED, digest="here", **more):
    found = resolve(settings, scene, passes, learning, lambda: digest, **more)
    return found, [str(notice.problem) for notice in found.notices]


def test_a_plain_scene_keeps_what_is_asked_for():
    found, problems = resolved(CACHED, scene_of())
    settings = found.request.settings
    assert (settings.radiance_cache, settings.spectral, problems) == ("CONVERGING", "OFF", [])
    # And nothing is learned about a dimension that the scene does not have.
    assert settings.u_dimension == "NONE"


def test_dispersion_gives_paths_wavelengths_which_the_cache_does_not_know():
    found, problems = resolved(CACHED, scene_of(disperses=True))
    assert (found.request.settings.spectral, found.request.settings.u_dimension) == ("ON", "WAVELENGTH")
    assert found.request.settings.radiance_cache == "OFF" and problems == ["knows no wavelengths"]
    assert resolved(RenderSettings(), scene_of(disperses=True))[1] == [], "nobody asked for the cache"


def test_time_comes_before_wavelengths():
    assert resolved(RenderSettings(), scene_of(moves=True, disperses=True))[0].request.settings.u_dimension == "TIME"
    only = RenderSettings(u_dimension="WAVELENGTH")
    assert resolved(only, scene_of(moves=True))[0].request.settings.u_dimension == "NONE"


@pytest.mark.parametrize("kind", ["CONVERGING", "FAST", "AUTO"])
@pytest.mark.parametrize("having", [{"catches": True}, {"media": True}])
def test_the_cache_is_there_with_shadow_catchers_and_media(kind, having):
    found, problems = resolved(RenderSettings(radiance_cache=kind), scene_of(**having))
    assert (found.request.settings.radiance_cache, problems, found.cache_left_out) == (kind, [], "")


def test_light_groups_need_paths_that_measure_the_cache():
    passes, scene = COMBINED | {"Combined_Key"}, scene_of(groups=("Key",))
    found, problems = resolved(CACHED, scene, passes)
    assert found.request.settings.radiance_cache == "CONVERGING" and problems == []
    assert found.request.layout.measures_groups and not resolved(CACHED, scene)[0].request.layout.measures_groups
    fast = RenderSettings(radiance_cache="FAST")
    found, problems = resolved(fast, scene, passes)
    assert found.request.settings.radiance_cache == "OFF" and problems == ["knows no light groups"]
    # A light group that nobody asks for is no reason.
    assert resolved(fast, scene)[0].request.settings.radiance_cache == "FAST"


@pytest.mark.parametrize("fast_gi", [FastGi(bounces=1), FastGi(added=0.5)])
def test_the_cache_is_left_where_light_is_no_longer_followed_as_it_is(fast_gi):
    found, problems = resolved(CACHED, scene_of(fast_gi=fast_gi))
    assert found.request.settings.radiance_cache == "OFF"
    assert problems[-1:] == ["knows no Fast GI Approximation"]


@pytest.mark.parametrize(("method", "count"), [("VMM", 1), ("AUTO", 0), ("OFF", 0)])
def test_nothing_learned_changes_densities_where_rays_are_short(method, count):
    """The picture depends on them there. Automatic guiding is what pays: nobody has asked for it."""
    asked = RenderSettings(guiding_method=method)
    found, problems = resolved(asked, scene_of(fast_gi=FastGi(bounces=1)))
    settings = found.request.settings
    assert settings.guiding_method == "OFF" and not settings.is_guided and not settings.learns_lights
    assert problems == ["knows no short rays (Fast GI Approximation)"] * count
    added, problems = resolved(asked, scene_of(fast_gi=FastGi(added=0.5)))
    assert added.request.settings.guiding_method == method and problems == []


def test_an_automatic_cache_is_left_without_a_warning_where_it_cannot_be():
    """Nobody has asked for it: the reason is for the report."""
    automatic = RenderSettings(radiance_cache="AUTO")
    found, problems = resolved(automatic, scene_of())
    assert (found.request.settings.radiance_cache, found.cache_left_out, problems) == ("AUTO", "", [])
    assert found.request.layout.use_residual
    for settings, scene, reason in (
        (automatic, scene_of(disperses=True), "wavelengths"),
        (replace(automatic, samples=LEAST_CACHED_SAMPLES - 1), scene_of(), "so few samples"),
        (replace(automatic, use_denoising=True), scene_of(), "a denoiser takes noise away"),
    ):
        found, problems = resolved(settings, scene)
        assert found.request.settings.radiance_cache == "OFF" and not found.request.layout.use_residual
        assert reason in found.cache_left_out and problems == []


def test_who_asks_for_a_denoiser_s_passes_denoises_elsewhere():
    passes = frozenset({"Combined", "Denoising Albedo"})
    for kind, left in (("AUTO", "OFF"), ("CONVERGING", "CONVERGING")):
        found = resolve(RenderSettings(radiance_cache=kind), scene_of(), passes, LearningRequest(), str)
        assert found.request.settings.radiance_cache == left
        assert bool(found.cache_left_out) == (kind == "AUTO")


@pytest.mark.parametrize(("roulette", "count"), [("LEARNED", 1), ("AUTO", 0), ("THROUGHPUT", 0)])
def test_roulette_goes_by_the_throughput_in_media(roulette, count):
    found, problems = resolved(RenderSettings(roulette=roulette), scene_of(media=True))
    assert found.request.settings.roulette == "THROUGHPUT" and problems == ["knows no media"] * count
    assert resolved(RenderSettings(roulette=roulette), scene_of())[0].request.settings.roulette == roulette


def test_a_learned_field_counts_where_light_is_as_it_was():
    start = SimpleNamespace(light_digest="here", seed=lambda seed: seed + 7)
    learning = LearningRequest(start=start)
    found, problems = resolved(GUIDED, scene_of(), learning=learning)
    assert found.request.learning.start is start and found.request.settings.seed == 8 and problems == []
    found, problems = resolved(GUIDED, scene_of(), learning=learning, digest="elsewhere")
    assert found.request.learning.start is None and found.request.settings.seed == 1
    assert problems == ["lights, materials or geometry are not those that it was learned with"]
    # What is not guided asks for no digest.
    off = RenderSettings(guiding_method="OFF", seed=1)
    found = resolve(off, scene_of(), COMBINED, learning, lambda: pytest.fail("a digest takes seconds"))
    assert found.request.learning.start is None and found.notices == ()


def test_strata_are_as_many_as_the_film_has_room_for():
    guided = RenderSettings(guiding_method="NPM", mixture_u="PLANES", samples=1024, strata=4)
    assert resolved(guided, scene_of(moves=True))[0].request.settings.strata == 4
    large = scene_of(moves=True)
    large.description.frame = Frame(1 << 14, 1 << 14, (0, 0, 1 << 14, 1 << 14))
    request = resolved(guided, large)[0].request
    assert request.settings.strata < 4
    assert type(resolved(guided, scene_of(moves=True))[0].request.make_film()) is StrataFilm


def test_a_cluster_counts_in_rays_and_lets_kernels_compute_networks():
    given = RenderSettings(deterministic=False, network_backend="ONNXRUNTIME")
    here = resolved(given, scene_of())[0].request.settings
    assert (here.deterministic, here.network_backend) == (False, "ONNXRUNTIME")
    there = resolved(given, scene_of(), on_cluster=True)[0].request.settings
    assert (there.deterministic, there.network_backend) == (True, "KERNEL")


@pytest.mark.parametrize(("first_samples", "samples"), [(None, 64), (8, 8), (100, 64)])
def test_a_render_stops_at_the_first_samples_that_are_asked_for(first_samples, samples):
    request = resolved(RenderSettings(samples=64), scene_of(), first_samples=first_samples)[0].request
    assert (request.samples, request.settings.samples) == (samples, 64)


STRATA = RenderSettings(guiding_method="NPM", mixture_u="PLANES", samples=64, strata=4)


@pytest.mark.parametrize(
    ("changes", "scene", "problem", "fallback"),
    [
        ({"guiding_method": "VMM"}, {"moves": True}, "no neural mixture guides", "not used"),
        ({"guiding_method": "AUTO"}, {"moves": True}, "no neural mixture guides", "not used"),
        ({"guiding_method": "OFF"}, {"moves": True}, "no neural mixture guides", "not used"),
        ({}, {}, "neither time nor wavelengths", "not used"),
        ({"u_dimension": "WAVELENGTH"}, {"moves": True}, "neither time nor wavelengths", "not used"),
        ({"samples": 16}, {"moves": True}, "too few samples", "there are 2"),
        ({"samples": 7}, {"moves": True}, "too few samples", "not used"),
    ],
)
def test_strata_that_are_left_out_are_noticed(changes, scene, problem, fallback):
    found, _ = resolved(replace(STRATA, **changes), scene_of(**scene))
    (notice,) = found.notices
    assert notice.subject == "Strata" and problem in notice.problem and fallback in notice.fallback


def test_a_field_of_a_sequence_has_no_strata():
    learning = LearningRequest(source=SimpleNamespace(u_dimension="TIME"))
    found, problems = resolved(STRATA, scene_of(moves=True), learning=learning)
    assert found.request.settings.strata == 1 and problems == ["nothing is learned within a frame"]


@pytest.mark.parametrize(("asked", "count"), [(0, 1), (1, 1), (4, 4), (7, 4)])
def test_strata_become_a_power_of_two_without_a_word(asked, count):
    found, problems = resolved(replace(STRATA, strata=asked), scene_of(moves=True))
    assert found.request.settings.strata == count and problems == []
