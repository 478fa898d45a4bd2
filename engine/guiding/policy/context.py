# SPDX-License-Identifier: GPL-3.0-or-later
"""What is known of a render before its first sample, for all that learns in it."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from engine.guiding.models.report import GuidingReport
from engine.guiding.policy.metered import MeteredExecutor
from engine.guiding.policy.request import NOTHING_ASKED, LearningRequest
from engine.guiding.policy.rules import Rules
from engine.scene.description import Notice
from engine.settings import RenderSettings


@dataclass(frozen=True)
class RenderContext:
    """What is known of a render before its first sample.

    settings : RenderSettings
    thread_count : int
    pixel_count : int, of the image
    unit_pixels : int, of the largest unit of work
    request : LearningRequest
    light_clusters : bool (C,) or None, which of the scene's clusters of lights can be sampled; None: nothing is learned
        about lights
    trial_share : float, of the pixels that units of a trial can have. Until guiding has been found to pay, it is tried
        on these alone
    has_media : bool, whether the scene has media. Guiding seldom pays there: it is tried cautiously, from the fifth
        sample on, by what four unguided ones have left
    report : GuidingReport, which all of them write to
    notices : list of Notice, for the user
    executor : MeteredExecutor, to learn with
    """

    settings: RenderSettings
    thread_count: int
    pixel_count: int
    unit_pixels: int
    request: LearningRequest = NOTHING_ASKED
    light_clusters: npt.NDArray[np.bool_] | None = None
    trial_share: float = 1.0
    has_media: bool = False
    report: GuidingReport = field(default_factory=GuidingReport)
    notices: list[Notice] = field(default_factory=list)
    executor: MeteredExecutor = field(default_factory=lambda: MeteredExecutor(1))

    @property
    def traces_while_learning(self) -> bool:
        """Whether threads trace while one of them learns (`engine.render.bridge`)."""
        return self.request.bridges(self.settings)

    @property
    def rules(self) -> Rules:
        """What learning goes by."""
        return self.request.rules
