# SPDX-License-Identifier: GPL-3.0-or-later
"""Images that are baked in bands of rows: as if they were baked as a whole, whatever ends them."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from addon import engine
from engine.render.session import Session
from engine.scene import bake as scene_bake
from tests.helpers.bake_scenes import SIZE, bake, baked_plane

pytest.importorskip("bpy")

#: Of the quarter of the image that has places.
COVERED = SIZE // 2


@pytest.fixture
def plane(blender: Any) -> tuple[Any, Any, Any]:
    """Scene, plane and image of `baked_plane`."""
    scene = blender.context.scene
    return (scene, *baked_plane(scene))


@pytest.fixture
def banded(monkeypatch: pytest.MonkeyPatch) -> Any:
    """Has bakes come in bands of three rows."""

    def begin() -> None:
        monkeypatch.setattr(scene_bake, "MOST_AT_ONCE", 1)
        monkeypatch.setattr(scene_bake, "BAND_TEXELS", 3 * SIZE)

    return begin


@pytest.fixture
def rendered(monkeypatch: pytest.MonkeyPatch) -> list[tuple[int, int]]:
    """First and last row of the places that are rendered at once."""
    rows: list[tuple[int, int]] = []
    real = Session.render

    def render(session: Any, **named: Any) -> Any:
        region = session.scene.description.bake.region
        rows.append((region[1], region[3]))
        return real(session, **named)

    monkeypatch.setattr(Session, "render", render)
    return rows


@pytest.mark.parametrize("kind", ["COMBINED", "EMIT", "AO", "SHADOW", "NORMAL"])
def test_bands_have_the_bits_of_the_whole(kind: str, plane: Any, banded: Any, rendered: list[tuple[int, int]]) -> None:
    """Random numbers are those of the texel in the image, and rows without a place are as ever."""
    scene, _, image = plane
    whole = bake(scene, image, "NEURALGUIDE", kind, 4)
    assert rendered == [(0, COVERED)]
    rendered.clear()
    banded()
    found = bake(scene, image, "NEURALGUIDE", kind, 4)
    assert rendered == [(0, 3), (3, 6), (6, COVERED)]
    assert np.array_equal(found, whole)
    assert np.ptp(whole[:COVERED, :COVERED, :3]) > 0.01 or kind in ("EMIT", "NORMAL")


def test_what_is_learned_in_bands_changes_no_mean(plane: Any, banded: Any) -> None:
    scene, _, image = plane
    scene.neuralguide.radiance_cache = "CONVERGING"
    whole = bake(scene, image, "NEURALGUIDE", "COMBINED", 256)[:COVERED, :COVERED, :3].mean()
    banded()
    found = bake(scene, image, "NEURALGUIDE", "COMBINED", 256, "VMM")[:COVERED, :COVERED, :3].mean()
    assert found == pytest.approx(whole, rel=0.01)


def test_denoised_bands_see_what_lies_beside_them(plane: Any, banded: Any, rendered: list[tuple[int, int]]) -> None:
    """All rows of so small an image are beside each band: the picture is that of the whole."""
    scene, _, image = plane
    noisy = bake(scene, image, "NEURALGUIDE", "COMBINED", 4)
    whole = bake(scene, image, "NEURALGUIDE", "COMBINED", 4, denoises=True)
    banded()
    found = bake(scene, image, "NEURALGUIDE", "COMBINED", 4, denoises=True)
    assert rendered == [(0, COVERED)] * 5
    assert np.array_equal(found, whole) and not np.array_equal(found, noisy)


def test_the_time_limit_is_that_of_all_bands(plane: Any, banded: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """Each gets as much of what is left as it has of the places that are left, however long those before it took."""
    from addon import baking

    scene, _, image = plane
    clock, limits = SimpleNamespace(now=0.0), list[float]()
    real = Session.render

    def render(session: Any, **named: Any) -> Any:
        limits.append(session.settings.time_limit)
        clock.now += (100.0, 200.0, 1e9)[len(limits) - 1]
        return real(session, **named)

    banded()
    scene.neuralguide.time_limit = 800.0
    monkeypatch.setattr(Session, "render", render)
    monkeypatch.setattr(baking, "time", SimpleNamespace(monotonic=lambda: clock.now))
    bake(scene, image, "NEURALGUIDE", "COMBINED", 1)
    assert limits == [pytest.approx(800.0 * 3 / 8), pytest.approx(700.0 * 3 / 5), pytest.approx(500.0)]


def test_of_a_bake_that_is_cancelled_bands_stay_that_there_are(
    plane: Any, banded: Any, rendered: list[tuple[int, int]], monkeypatch: pytest.MonkeyPatch
) -> None:
    """It is cancelled while the second of three bands is rendered."""
    scene, _, image = plane
    banded()
    monkeypatch.setattr(engine, "cancel_hooks", [lambda: len(rendered) > 1])
    found = bake(scene, image, "NEURALGUIDE", "COMBINED", 1 << 14)
    assert len(rendered) == 2
    assert (found[:3, :COVERED, :3] > 0.01).all() and not found[6:COVERED, :COVERED, :3].any()
