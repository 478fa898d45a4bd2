# SPDX-License-Identifier: GPL-3.0-or-later
"""What outlives a render: its learned field, and records of its last iteration."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

from engine.guiding.fields.state import check_numbers
from engine.guiding.policy.agenda import Agenda
from engine.guiding.policy.cautious import CautiousTrial
from engine.guiding.policy.context import RenderContext
from engine.guiding.policy.evidence import Evidence
from engine.guiding.policy.learnables.predictors import LearnedPredictors
from engine.guiding.policy.learnables.regions import LearnedRegions
from engine.guiding.policy.questions.guiding import GuidingQuestion
from engine.guiding.policy.questions.method import MethodQuestion
from engine.guiding.policy.recording import Recording
from engine.guiding.records.unit_records import UnitRecords
from engine.guiding.records.vertices import join_records
from engine.guiding.saved.learned import LearnedField


class FieldKeeper:
    """Keeps what a guided render has learned.

    Parameters
    ----------
    context : RenderContext
    evidence : Evidence
    regions : LearnedRegions
    predictors : LearnedPredictors
    guiding : GuidingQuestion
    method : MethodQuestion
    cautious : CautiousTrial or None
        What has records that nothing was learned from.
    """

    def __init__(
        self, context: RenderContext, evidence: Evidence, regions: LearnedRegions, predictors: LearnedPredictors,
        guiding: GuidingQuestion, method: MethodQuestion, cautious: CautiousTrial | None,
    ) -> None:
        self._context, self._evidence, self._regions, self._predictors = context, evidence, regions, predictors
        self._guiding, self._method, self._cautious = guiding, method, cautious

    def learned(self, light_digest: str, recording: Recording) -> LearnedField | None:
        """All that was learned so far of the scene of this digest, for other renders; None while there is nothing.

        Raises
        ------
        StateError
            If no render could start from it: light was so bright that sums of its squares are out of bounds.
        """
        if self._regions.models is None:
            return None
        state = {**self._regions.state(), **self._predictors.state()}
        check_numbers(state)
        efficiency, image = self._guiding.trial.efficiency, self._evidence.image
        return LearnedField(
            state, light_digest, self._method.trial.rung, self._guiding.verdict,
            efficiency if math.isfinite(efficiency) else 0.0, self._evidence.samples,
            recording.budget.records_per_path, image.ray_count, image.variance, image.brightness,
        )

    def wants_last(self, agenda: Agenda) -> bool:
        """Whether the last iteration's records are of use: to the sink, or to what outlives the render."""
        return self._context.request.sink is not None or self._learns_last(agenda)

    def _learns_last(self, agenda: Agenda) -> bool:
        samples = self._samples(agenda)
        share = samples / max(self._evidence.samples + samples, 1e-9)
        is_kept = self._context.request.keeps and not self._guiding.is_over
        return is_kept and share >= self._context.rules.least_last

    @staticmethod
    def _samples(agenda: Agenda) -> float:
        """Guided samples a pixel of the iteration in work."""
        return sum(arm.sample_count for arm in agenda.arms) * agenda.guided_share * agenda.pixel_share

    def take_last(self, units: Sequence[UnitRecords], agenda: Agenda) -> None:
        """Take the records of the last iteration, which nothing in this render can be guided by."""
        if self._cautious is not None:
            units = [*self._cautious.held, *units]
        records, row_count = join_records([unit.vertices for unit in units])
        if self._context.request.sink is not None:
            self._context.request.sink.take(records, row_count)
        if not row_count or not self._learns_last(agenda):
            return
        image = self._evidence.image
        image = replace(image, ray_count=max(image.ray_count, 1.0))
        self._regions.fit(records, row_count, image, was_guided=agenda.way.is_guided)
        self._predictors.follow_regions()
        self._evidence.samples += self._samples(agenda)
