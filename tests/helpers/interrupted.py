# SPDX-License-Identifier: GPL-3.0-or-later
"""Renders that are interrupted at a moment which no clock decides, and taken up."""

from __future__ import annotations

import threading
from dataclasses import replace
from pathlib import Path
from typing import Any

from engine.render.checkpointing import Checkpointing, CheckpointPlan
from engine.render.film import Film
from engine.render.render_loop import RenderLoop
from engine.render.report import RenderResult
from engine.render.session import Session
from engine.scene.description import Notice, SceneDescription
from engine.scene.digest import SceneDigest
from engine.settings import RenderSettings


class Renderer:
    """Renders one scene into one checkpoint, by one thread.

    Parameters
    ----------
    monkeypatch : pytest.MonkeyPatch
    description : SceneDescription
    path : Path
        Of the checkpoint.
    passes : set of str
    **settings
        Of `RenderSettings`.
    """

    def __init__(
        self, monkeypatch: Any, description: SceneDescription, path: Path, passes: set[str], **settings: Any
    ) -> None:
        self.settings = RenderSettings(**{"threads": 1, **settings})
        self.plan = CheckpointPlan(path, SceneDigest(description), self.settings.seed)
        self.notices: list[Notice] = []
        self.resumed = 0
        self._monkeypatch, self._passes = monkeypatch, passes
        self._session = Session(self.settings)
        self._session.load(description)

    def whole(self) -> RenderResult:
        """Render without checkpoints."""
        self._session.checkpointing = None
        return self._session.render(passes=self._passes)

    def interrupted(self, merges: int, **plan: Any) -> RenderResult:
        """Render until so many units are on the film."""
        return self._render(_Interruption(merges), plan)

    def taken_up(self, **plan: Any) -> RenderResult:
        """Go on from the checkpoint to the end."""
        return self._render(None, {"resumes": True} | plan)

    def _render(self, interruption: _Interruption | None, plan: dict[str, Any]) -> RenderResult:
        self.notices = []
        checkpointing = Checkpointing(replace(self.plan, **plan), self.notices.append)
        self._session.settings, self._session.checkpointing = self.settings, checkpointing
        with self._monkeypatch.context() as patch:
            if interruption is not None:
                interruption.install(patch)
            should_cancel = None if interruption is None else interruption.should_cancel
            try:
                result = self._session.render(passes=self._passes, should_cancel=should_cancel)
            finally:
                checkpointing.close()
        self.resumed = checkpointing.resumed
        return result


class _Interruption:
    """Holds the thread that is to trace the next unit until the render is told to stop."""

    def __init__(self, merges: int) -> None:
        self._left = merges
        self._is_told = False
        self._is_reached, self._is_stopped = threading.Event(), threading.Event()

    def install(self, patch: Any) -> None:
        """Count units, and wait between them: whoever waits holds no lock."""
        merge, unit = Film.merge, RenderLoop.unit

        def counting_merge(film: Film, *arguments: Any, **named: Any) -> None:
            merge(film, *arguments, **named)
            self._left -= 1
            if self._left == 0:
                self._is_reached.set()

        def waiting_unit(loop: RenderLoop, task: Any) -> Any:
            if self._is_reached.is_set():
                assert self._is_stopped.wait(300.0)
            return unit(loop, task)

        patch.setattr(Film, "merge", counting_merge)
        patch.setattr(RenderLoop, "unit", waiting_unit)

    def should_cancel(self) -> bool:
        """Asked a second time once the job knows."""
        if self._is_told:
            self._is_stopped.set()
        self._is_told = self._is_reached.is_set()
        return self._is_told
