# SPDX-License-Identifier: GPL-3.0-or-later
"""One render, once it is known what counts of what was asked for."""

from __future__ import annotations

from dataclasses import dataclass

from engine.guiding.policy.request import NOTHING_ASKED, LearningRequest
from engine.render.film import Film
from engine.render.loop_state import NOTHING_DONE, LoopState
from engine.render.strata import StrataFilm
from engine.scene.description import Frame
from engine.settings import RenderSettings
from engine.state.film import PLAIN_LAYOUT, FilmLayout


@dataclass(frozen=True)
class RenderRequest:
    """What a render goes by. `engine.render.resolution.resolve` makes it, and nobody changes it afterwards.

    frame : Frame
    settings : RenderSettings, with an answer wherever they leave one open, and without what the scene cannot have
    layout : FilmLayout
    learning : LearningRequest, without a learned field that does not fit
    first_samples : int or None, where to stop, before the number of the settings
    resumed : LoopState, how far the render had come before it was interrupted
    """

    frame: Frame
    settings: RenderSettings
    layout: FilmLayout = PLAIN_LAYOUT
    learning: LearningRequest = NOTHING_ASKED
    first_samples: int | None = None
    resumed: LoopState = NOTHING_DONE

    @property
    def samples(self) -> int:
        """Where to stop."""
        most = self.settings.samples
        return most if self.first_samples is None else min(self.first_samples, most)

    def begin(self) -> tuple[RenderRequest, Film]:
        """The same, and an empty film."""
        return self, self.make_film()

    def make_film(self) -> Film:
        """An empty film of the frame's region."""
        x0, y0, x1, y1 = self.frame.region
        if self.settings.strata > 1:
            return StrataFilm(x1 - x0, y1 - y0, self.settings.strata, self.layout)
        return Film(x1 - x0, y1 - y0, self.layout)
