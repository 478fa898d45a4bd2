# SPDX-License-Identifier: GPL-3.0-or-later
"""While kernels compile the picture is a bar that grows: nobody looks at black and 0%."""

from __future__ import annotations

from collections.abc import Iterator
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from engine.render.report import Progress
from tests.helpers.fake_engine import FakeEngine, FakeSession


def compiling(fraction: float) -> Progress:
    return Progress(fraction, 0, 4, 2.0, None, 0.0, f"Compiling kernels (once): {48 * fraction:.0f} of 48 kernels")


@pytest.fixture
def seconds(monkeypatch: Any) -> Iterator[list[float]]:
    """The clock of waiting pictures; tests set it."""
    from addon import waiting_picture

    now = [0.0]
    monkeypatch.setattr(waiting_picture, "time", SimpleNamespace(monotonic=lambda: now[0]))
    yield now


def test_the_bar_grows_and_nothing_is_black() -> None:
    from addon.waiting_picture import waiting_picture

    means = []
    for fraction in (0.0, 0.25, 1.0):
        picture = waiting_picture(54, 96, fraction)
        assert picture.shape == (54, 96, 4) and picture.dtype == np.float32
        assert picture[..., :3].min() > 0.01 and (picture[..., 3] == 1.0).all()
        means.append(picture[..., 0].mean())
    assert means == sorted(means) and means[0] < means[-1]
    assert waiting_picture(1, 1, 0.5).shape == (1, 1, 4)


def test_it_waits_a_second_and_ends_with_the_first_picture(seconds: list[float]) -> None:
    from addon.waiting_picture import WaitingPicture

    shown: list[Any] = []
    waiting = WaitingPicture(shown.append, 4, 6)
    waiting.update(compiling(0.1))
    assert shown == [], "a render that begins at once does not flash"
    seconds[0] = 1.5
    waiting.update(compiling(0.2))
    waiting.update(compiling(0.2))
    assert len(shown) == 1
    seconds[0] = 2.5
    waiting.update(compiling(0.3))
    assert len(shown) == 2
    waiting.end()
    seconds[0] = 60.0
    waiting.update(compiling(0.4))
    assert len(shown) == 2


def test_a_render_shows_it_until_there_is_a_picture(
    cube_scene: Any, monkeypatch: Any, seconds: list[float]
) -> None:
    import bpy

    from addon import passes
    from addon.engine import NeuralGuideRenderEngine, outcomes

    FakeEngine(monkeypatch)
    load, write = FakeSession.load, passes.write_layer
    written: list[float] = []

    def load_slowly(self: Any, description: Any, *, on_progress: Any, **options: Any) -> Any:
        for step in range(4):
            seconds[0] += 1.0
            on_progress(compiling(step / 4))
        return load(self, description, on_progress=on_progress, **options)

    def note(layer: Any, view: str, wanted: Any, images: Any) -> None:
        written.append(float(images["Combined"][0, 0, 0]))
        write(layer, view, wanted, images)

    monkeypatch.setattr(FakeSession, "load", load_slowly)
    monkeypatch.setattr(passes, "write_layer", note)
    monkeypatch.setattr(NeuralGuideRenderEngine, "shows_waiting", True)
    bpy.ops.render.render()
    assert outcomes[-1].status == "FINISHED"
    grey = written[0]
    assert grey > 0.01 and written[:3] == [grey] * 3 and grey not in written[4:], "then what was rendered"
