# SPDX-License-Identifier: GPL-3.0-or-later
"""What is asked of a render's learning, besides the settings."""

from __future__ import annotations

from dataclasses import dataclass

from engine.guiding.models.record_sink import RecordSink
from engine.guiding.models.source_model import TrainedSource
from engine.guiding.policy.rules import RULES, Rules
from engine.guiding.saved.learned import LearnedField
from engine.settings import RenderSettings


@dataclass(frozen=True)
class LearningRequest:
    """What is asked of a render's learning.

    source : TrainedSource or None, what directions are drawn from, instead of what the settings would have learned
    sink : RecordSink or None, gets all records, those of the last iteration too, which nothing in the render can learn
        from
    start : LearnedField or None, what to guide by from the first sample on, and to learn more onto. Where guiding has
        lost in the render that it is of, this one learns anew, unless there is no trial
    keeps : bool, whether what is learned outlives the render, so that the last iteration is worth learning from
    rules : Rules
    """

    source: TrainedSource | None = None
    sink: RecordSink | None = None
    start: LearnedField | None = None
    keeps: bool = False
    rules: Rules = RULES

    @property
    def is_for_later(self) -> bool:
        """Whether records are of use after the render."""
        return self.keeps or self.sink is not None

    def bridges(self, settings: RenderSettings) -> bool:
        """Whether threads trace while one of them learns: not where all samples are to teach, nor within strata."""
        return settings.strata <= 1 and not self.is_for_later


#: Nothing but what the settings say.
NOTHING_ASKED = LearningRequest()
