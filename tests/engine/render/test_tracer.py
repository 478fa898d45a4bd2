# SPDX-License-Identifier: GPL-3.0-or-later
"""A tracer stays with its session: kernels and memory are made once, and nothing of an earlier render shows."""

from dataclasses import replace

import numpy as np
import pytest

from engine.render.batch import Batch
from engine.render.precompile_worker import small_scene
from engine.render.session import Session
from engine.render.tracer import Tracer
from engine.scene.description import Link, Node, SceneDescription, World
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


def _foggy_scene(density: float) -> SceneDescription:
    description = small_scene()
    graph = next(material.graph for material in description.materials if material.graph is not None)
    graph.nodes.append(Node("ShaderNodeVolumeScatter", "Fog", {"Density": density}))
    graph.volume = Link(len(graph.nodes) - 1, "Volume")
    return description


def test_media_that_become_dense_have_the_stage_that_they_need(made: list[str]) -> None:
    """The loop called a stage that nobody had linked, and the process ended."""
    settings = RenderSettings(samples=2, threads=1, guiding_method="OFF", roulette="THROUGHPUT")
    session = Session(settings)
    _render(session, _foggy_scene(0.1))
    dense = _render(session, _foggy_scene(1e5))
    assert made == ["batch", "link", "link"]
    np.testing.assert_array_equal(dense, _render(Session(settings), _foggy_scene(1e5)))


def test_threads_have_other_memory_where_settings_ask_for_it(made: list[str]) -> None:
    session = Session(RenderSettings(samples=2, threads=1))
    _render(session, small_scene())
    session.settings = replace(session.settings, threads=2)
    _render(session, small_scene())
    assert made.count("batch") == 3
