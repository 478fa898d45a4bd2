# SPDX-License-Identifier: GPL-3.0-or-later
"""What a session asks of a job and the job's loop knows, whoever traces."""

from __future__ import annotations

import threading

from engine.guiding.policy.guidance import Guidance
from engine.guiding.policy.learner import Learner
from engine.render.looks import Looks
from engine.render.loop_state import LoopState
from engine.render.render_loop import RenderLoop
from engine.scene.description import Notice


class RenderLoopJob:
    """What a session asks of a job and the job's loop knows, whoever traces."""

    _loop: RenderLoop

    @property
    def film_lock(self) -> threading.Lock:
        """For whoever reads the film meanwhile."""
        return self._loop.film_lock

    def holding_tasks(self) -> threading.Condition:
        """Within it no task is handed out or finished."""
        return self._loop.changed

    def state(self, *, is_over: bool) -> LoopState | None:
        """How far it has come, as `RenderLoop.state`."""
        return self._loop.state(is_over=is_over)

    @property
    def notices(self) -> list[Notice]:
        """What users should know of how it went."""
        learner = self._loop.learner
        return [*(() if learner is None else learner.notices), *self._loop.looks.notices]

    @property
    def has_paths(self) -> bool:
        """Whether there is anything to show; it may be a part of the image."""
        return self._loop.paths.has_paths

    @property
    def learner(self) -> Learner | None:
        """What learns."""
        return self._loop.learner

    @property
    def guidance(self) -> Guidance | None:
        """What the newest iteration goes by; None of a render that learns nothing."""
        return self._loop.guidance

    @property
    def looks(self) -> Looks:
        """Who looks at the picture meanwhile."""
        return self._loop.looks

    @property
    def ended_by(self) -> str:
        """Of `ENDINGS`, once it is known."""
        return self._loop.ended_by

    @ended_by.setter
    def ended_by(self, ending: str) -> None:
        self._loop.ended_by = ending
