# SPDX-License-Identifier: GPL-3.0-or-later
"""What of a render's settings counts in a scene, and which notices say why the rest does not."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from engine.guiding.policy.request import NOTHING_ASKED, LearningRequest
from engine.render.resolution import resolve
from engine.settings import RenderSettings

COMBINED = frozenset({"Combined"})
CACHED = RenderSettings(radiance_cache="CONVERGING")
GUIDED = RenderSettings(guiding_method="AUTO", seed=1)


def scene_of(*, moves=False, disperses=False, groups=(), catches=False, media=False):
    description = SimpleNamespace(is_moving=moves, has_dispersion=disperses, light_groups=groups)
    return SimpleNamespace(description=description, has_catchers=catches, media=SimpleNamespace(is_used=media))


def resolved(settings, scene, passes=COMBINED, request=NOTHING_ASKED, digest="here"):
    found = resolve(settings, scene, passes, request, lambda: digest)
    return found, [str(notice.problem) for notice in found.notices]


def test_a_plain_scene_keeps_what_is_asked_for():
    found, problems = resolved(CACHED, scene_of())
    assert (found.settings.radiance_cache, found.settings.spectral, problems) == ("CONVERGING", "OFF", [])
    # And nothing is learned about a dimension that the scene does not have.
    assert found.settings.u_dimension == "NONE"


def test_dispersion_gives_paths_wavelengths_which_the_cache_does_not_know():
    found, problems = resolved(CACHED, scene_of(disperses=True))
    assert (found.settings.spectral, found.settings.u_dimension) == ("ON", "WAVELENGTH")
    assert found.settings.radiance_cache == "OFF" and problems == ["knows no wavelengths"]
    assert resolved(RenderSettings(), scene_of(disperses=True))[1] == [], "nobody asked for the cache"


def test_time_comes_before_wavelengths():
    assert resolved(RenderSettings(), scene_of(moves=True, disperses=True))[0].settings.u_dimension == "TIME"
    only = RenderSettings(u_dimension="WAVELENGTH")
    assert resolved(only, scene_of(moves=True))[0].settings.u_dimension == "NONE"


@pytest.mark.parametrize("lacking", [{"catches": True}, {"media": True}, {"groups": ("Key",)}])
def test_the_cache_is_left_where_it_lacks_something(lacking):
    passes = COMBINED | {"Combined_Key"}
    found, problems = resolved(CACHED, scene_of(**lacking), passes)
    assert found.settings.radiance_cache == "OFF"
    assert problems == ["knows no light groups, shadow catchers or media"]
    # A light group that nobody asks for is no reason.
    if "groups" in lacking:
        assert resolved(CACHED, scene_of(**lacking))[0].settings.radiance_cache == "CONVERGING"


@pytest.mark.parametrize(("roulette", "count"), [("LEARNED", 1), ("AUTO", 0), ("THROUGHPUT", 0)])
def test_roulette_goes_by_the_throughput_in_media(roulette, count):
    found, problems = resolved(RenderSettings(roulette=roulette), scene_of(media=True))
    assert found.settings.roulette == "THROUGHPUT" and problems == ["knows no media"] * count
    assert resolved(RenderSettings(roulette=roulette), scene_of())[0].settings.roulette == roulette


def test_a_learned_field_counts_where_light_is_as_it_was():
    start = SimpleNamespace(light_digest="here", seed=lambda seed: seed + 7)
    request = LearningRequest(start=start)
    found, problems = resolved(GUIDED, scene_of(), request=request)
    assert found.request.start is start and found.settings.seed == 8 and problems == []
    found, problems = resolved(GUIDED, scene_of(), request=request, digest="elsewhere")
    assert found.request.start is None and found.settings.seed == 1
    assert problems == ["lights, materials or geometry are not those that it was learned with"]
    # What is not guided asks for no digest.
    off = RenderSettings(guiding_method="OFF", seed=1)
    found = resolve(off, scene_of(), COMBINED, request, lambda: pytest.fail("a digest takes seconds"))
    assert found.request.start is None and found.notices == ()
