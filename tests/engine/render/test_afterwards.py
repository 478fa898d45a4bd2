# SPDX-License-Identifier: GPL-3.0-or-later
"""When the samples are there the picture is safe, whatever else fails."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import engine.render.denoising as denoising
from engine.denoise import library
from engine.guiding.models.report import GuidingReport
from engine.guiding.policy.conductor import Conductor
from engine.render.afterwards import Afterwards
from engine.render.render_loop import RenderLoop
from engine.render.session import Session
from engine.settings import RenderSettings
from tests.helpers.small_scenes import corner_scene


def render(**settings: Any) -> Any:
    session = Session(RenderSettings(**{"samples": 4, "threads": 1, **settings}))
    session.load(corner_scene())
    result = session.render(passes=("Combined", "Noisy Image"), keep=True)
    session.close()
    return result


def fail(*_arguments: Any, **_named: Any) -> None:
    raise ZeroDivisionError("of the test")


def problems(result: Any) -> list[str]:
    return [f"{notice.subject}: {notice.problem}" for notice in result.report.notices]


def test_what_fails_is_said_and_what_does_not_is_returned() -> None:
    afterwards = Afterwards()
    assert afterwards.attempt("Report", "writing it", lambda: 7, "figures are missing") == 7
    assert not afterwards.notices
    assert afterwards.attempt("Report", "writing it", fail, "figures are missing") is None
    (notice,) = afterwards.notices
    assert (notice.subject, notice.fallback) == ("Report", "figures are missing")
    assert notice.problem == "writing it failed (ZeroDivisionError: of the test)"


@pytest.mark.skipif(bool(library.problem()), reason="no Open Image Denoise here")
@pytest.mark.parametrize(("error", "said"), [
    (MemoryError(), "Denoising: out of memory"), (RuntimeError("lost"), "Denoising: failed: RuntimeError: lost"),
])  # fmt: skip
def test_a_denoiser_that_fails_in_any_way_leaves_the_sampled_picture(
    monkeypatch: Any, error: Exception, said: str
) -> None:
    def denoise(*_arguments: Any, **_named: Any) -> None:
        raise error

    monkeypatch.setattr(denoising, "denoise_all", denoise)
    result = render(use_denoising=True)
    assert problems(result) == [said]
    assert np.array_equal(result.passes["Combined"], result.passes["Noisy Image"])
    assert result.passes["Combined"].max() > 0.0


@pytest.mark.parametrize("step", ["close", "learned", "report"])
def test_what_was_learned_may_be_lost_but_not_the_picture(monkeypatch: Any, step: str) -> None:
    if step == "close":
        real = Conductor.close

        def close(self: Conductor) -> None:
            real(self)
            fail()

        monkeypatch.setattr(Conductor, "close", close)
    else:
        owner, name = (GuidingReport, "describe") if step == "report" else (Conductor, "learned")
        monkeypatch.setattr(owner, name, fail)
    result = render(guiding_method="VMM", guiding_trial=False, samples=16)
    assert any("ZeroDivisionError: of the test" in problem for problem in problems(result))
    assert result.passes["Combined"].max() > 0.0
    assert result.report.sample_count == 16.0
    assert (result.learned is None) == (step == "learned")


def test_what_was_rendered_before_a_thread_failed_is_shown(monkeypatch: Any) -> None:
    """The last picture may be minutes old by then."""
    finish = RenderLoop.finish
    tasks = []

    def fail_later(self: RenderLoop, task: Any) -> bool:
        tasks.append(task)
        if len(tasks) == 3:
            raise MemoryError
        return finish(self, task)

    monkeypatch.setattr(RenderLoop, "finish", fail_later)
    session = Session(RenderSettings(samples=64, threads=1))
    session.load(corner_scene())
    shown: list[np.ndarray] = []
    with pytest.raises(MemoryError):
        session.render(on_image=lambda images: shown.append(images["Combined"].copy()))
    session.close()
    assert shown and shown[-1].max() > 0.0
