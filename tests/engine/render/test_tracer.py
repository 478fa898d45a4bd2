# SPDX-License-Identifier: GPL-3.0-or-later
"""A tracer stays with its session: kernels and memory are made once, and nothing of an earlier render shows."""

from dataclasses import replace

import numpy as np
import pytest

from engine.render.batch import Batch
from engine.render.precompile_worker import small_scene
from engine.render.session import Session
from engine.render.tracer import Tracer
from engine.scene.description import SceneDescription, World
from engine.settings import RenderSettings


@pytest.fixture
def made(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Names of what tracers make: batches, and links of kernels."""
    names: list[str] = []
    warm_up, make = Tracer.warm_up, Batch.__init__

    def count_links(self: Tracer, *arguments: object) -> None:
        names.append("link")
        warm_up(self, *arguments)  # type: ignore[arg-type]

    def count_batches(self: Batch, *arguments: object, **named: object) -> None:
        names.append("batch")
        make(self, *arguments, **named)  # type: ignore[arg-type]

    monkeypatch.setattr(Tracer, "warm_up", count_links)
    monkeypatch.setattr(Batch, "__init__", count_batches)
    return names


def _render(session: Session, description: SceneDescription) -> np.ndarray:
    session.load(description)
    return session.render().passes["Combined"]


@pytest.mark.parametrize("method", ["OFF", "VMM_RIS"])
def test_renders_share_kernels_and_memory(method: str, made: list[str]) -> None:
    settings = RenderSettings(samples=8, threads=1, guiding_method=method)
    session = Session(settings)
    first = _render(session, small_scene())
    assert made == ["batch", "link"]
    moved = small_scene()
    moved.camera.transform[0, 3] = 0.2
    other = _render(session, moved)
    again = _render(session, small_scene())
    assert made == ["batch", "link"]
    assert np.array_equal(first, again) and not np.array_equal(first, other)
    np.testing.assert_array_equal(other, _render(Session(settings), moved))


def test_kernels_are_linked_again_where_a_scene_needs_others(made: list[str]) -> None:
    session = Session(RenderSettings(samples=2, threads=1))
    _render(session, small_scene())
    plain = replace(small_scene(), world=World("w", "World", None))
    image = _render(session, plain)
    assert made.count("link") == 2 and made.count("batch") == 1
    np.testing.assert_array_equal(image, _render(Session(session.settings), plain))


def test_threads_have_other_memory_where_settings_ask_for_it(made: list[str]) -> None:
    session = Session(RenderSettings(samples=2, threads=1))
    _render(session, small_scene())
    session.settings = replace(session.settings, threads=2)
    _render(session, small_scene())
    assert made.count("batch") == 3
