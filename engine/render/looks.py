# SPDX-License-Identifier: GPL-3.0-or-later
"""Looks at the picture of a render that goes on, between its steps or iterations: they may end it.

Two can look: the noise threshold, which drops pixels, and the threshold on the denoised picture.
"""

from __future__ import annotations

from collections.abc import Callable

from engine.render.adaptive import ActivePixels
from engine.render.denoised_threshold import DenoisedThreshold
from engine.render.film import Film
from engine.render.loop_state import LooksState
from engine.render.request import RenderRequest
from engine.render.tiles import FrameTiles
from engine.scene.description import Notice


class Looks:
    """Who looks at the picture of one render.

    Parameters
    ----------
    request : RenderRequest
    film : Film
    tiles : FrameTiles
        All pixels.
    thread_count : int
        Those that trace, which wait meanwhile.

    Attributes
    ----------
    active : ActivePixels or None
        Which pixels go on, where there is a noise threshold.
    denoised : DenoisedThreshold or None
        When the denoised picture is good, where that ends the render.
    """

    def __init__(self, request: RenderRequest, film: Film, tiles: FrameTiles, thread_count: int) -> None:
        settings, exposure = request.settings, request.frame.exposure
        self.active: ActivePixels | None = None
        self.denoised: DenoisedThreshold | None = None
        if settings.use_adaptive_sampling:
            self.active = ActivePixels(settings, film, exposure, tiles)
        if settings.denoised_threshold > 0.0:
            self.denoised = DenoisedThreshold(settings, film, exposure, thread_count)
        for one in (self.active, self.denoised):
            if one is not None:
                one.resume(request.resumed.looks)

    @property
    def state(self) -> LooksState:
        """What was found so far."""
        found = LooksState() if self.active is None else self.active.state
        return found if self.denoised is None else self.denoised.state(found)

    def look(self, samples: int, expect: Callable[[float], None]) -> str:
        """Look at the picture, if it is time to; one of `ENDINGS` if it is good enough, else ''.

        Parameters
        ----------
        samples : int
            That every pixel has which has been active all along.
        expect : callable
            Is told how many paths are still to come, if that is known anew.
        """
        active, denoised = self.active, self.denoised
        if active is not None and active.is_due(samples):
            active.look(samples)
            expect(active.expected_paths)
        if active is not None and active.count == 0:
            return "NOISE_THRESHOLD"
        if denoised is not None and denoised.is_due(samples) and denoised.look(samples):
            return "DENOISED_THRESHOLD"
        return ""

    def wait_for(self, samples: int) -> bool:
        """Whether the denoised picture is to be looked at after so many samples, before anything else is traced."""
        return self.denoised is not None and self.denoised.is_due(samples)

    def stop(self) -> None:
        """Nothing more is to be rendered: end a look that is under way."""
        if self.denoised is not None:
            self.denoised.stop()

    @property
    def denoised_error(self) -> float | None:
        """Error of the denoised picture as it was last estimated; None: it never was."""
        return None if self.denoised is None else self.denoised.error

    @property
    def denoised_look(self) -> int:
        """Samples a pixel at that."""
        return 0 if self.denoised is None else self.denoised.looked_at

    @property
    def notices(self) -> list[Notice]:
        """Why a look was not possible."""
        return [] if self.denoised is None else self.denoised.notices
