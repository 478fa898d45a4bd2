# SPDX-License-Identifier: GPL-3.0-or-later
"""Passes that are made one at a time are those that are made together, bit for bit, and few are kept."""

from __future__ import annotations

import threading
import weakref

import numba
import numpy as np
import pytest

from engine.render.film import PASS_NAMES, Film, PassImages, film_layout
from engine.render.light_passes import group_pass
from engine.render.session import Session
from engine.scene.pass_names import MATTE_KINDS, aov_pass, matte_passes
from engine.scene.passes import Aov, PassSettings
from engine.settings import RenderSettings
from engine.state.lanes import allocate_closures
from tests.helpers.small_scenes import corner_scene

AOVS = (Aov("Colour", True), Aov("Value", False))
MATTES = [name for kind in MATTE_KINDS for name in matte_passes(kind, 6)]
NAMES = frozenset({*PASS_NAMES, *MATTES, group_pass("Group"), *(aov_pass(aov.name) for aov in AOVS)})


def random_film(*, cache: str, has_catchers: bool) -> Film:
    settings = RenderSettings(radiance_cache=cache, use_adaptive_sampling=True)
    layout = film_layout(
        NAMES, settings, ("Group",), PassSettings(aovs=AOVS), has_catchers=has_catchers, has_media=True
    )
    film, random = Film(40, 24, layout), np.random.default_rng(3)
    for column in film.sums:
        is_real = column.dtype == np.float32
        column[...] = 3.0 * random.random(column.shape) if is_real else random.integers(0, 4, column.shape)
    return film


@pytest.mark.parametrize(("cache", "has_catchers"), [("OFF", True), ("OFF", False), ("CONVERGING", False)])
def test_each_is_that_of_all(cache: str, has_catchers: bool) -> None:
    film = random_film(cache=cache, has_catchers=has_catchers)
    together = film.passes(NAMES, exposure=1.5)
    images = PassImages(film, NAMES, 1.5, threading.Lock())
    assert set(together) == set(images) == NAMES
    for name in sorted(NAMES):
        np.testing.assert_array_equal(images[name], together[name], err_msg=name)
    depth = weakref.ref(images["Depth"])
    assert depth() is images["Depth"]
    assert images["Normal"] is not None and depth() is None, "a pass is kept after another was looked up"


def test_what_is_put_there_stays_and_what_is_taken_away_is_gone() -> None:
    images = PassImages(random_film(cache="OFF", has_catchers=False), NAMES, 1.0, threading.Lock())
    denoised = np.zeros((24, 40, 4), np.float32)
    images["Combined"] = denoised
    assert images["Combined"] is denoised and images["Noisy Image"].any()
    del images["Denoising Albedo"]
    assert "Denoising Albedo" not in images and "no such pass" not in images and len(images) == len(NAMES) - 1


def test_a_render_hands_out_the_same_either_way() -> None:
    passes = ("Combined", "Noisy Image", "Normal", "Depth")
    results = []
    for one_by_one in (False, True):
        session = Session(RenderSettings(samples=2, threads=1, use_denoising=True))
        session.load(corner_scene(size=(24, 16)))
        results.append(session.render(passes=passes, one_by_one=one_by_one).passes)
    assert set(results[0]) == set(results[1]) == set(passes)
    for name in passes:
        np.testing.assert_array_equal(results[0][name], results[1][name], err_msg=name)


def test_lanes_of_renders_with_aovs_are_of_the_type_of_those_without() -> None:
    """Else every stage would be compiled again for them."""
    plain, *others = (numba.typeof(allocate_closures(8, 3, width)) for width in (0, 1, 4, 9))
    assert others == [plain] * 3
