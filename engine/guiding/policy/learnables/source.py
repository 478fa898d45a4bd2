# SPDX-License-Identifier: GPL-3.0-or-later
"""What directions are drawn from, where that is not the mixture field."""

from __future__ import annotations

import time
from dataclasses import replace

from engine.guiding.models.source_model import SourceModel
from engine.guiding.policy.context import RenderContext
from engine.guiding.policy.guidance import Guidance
from engine.guiding.policy.iteration import Iteration
from engine.guiding.policy.learnables.learnable import Learnable, Rehearsal
from engine.guiding.policy.learnables.regions import LearnedRegions
from engine.guiding.policy.standing import Standing
from engine.guiding.policy.way import ImageState, Way


class LearnedSource(Learnable):
    """Learns a field that directions are drawn from.

    Parameters
    ----------
    context : RenderContext
    standing : Standing
    regions : LearnedRegions
    model : SourceModel
    """

    def __init__(
        self, context: RenderContext, standing: Standing, regions: LearnedRegions, model: SourceModel
    ) -> None:
        self._context, self._standing, self._regions, self._model = context, standing, regions, model
        self._is_given_up = False
        #: Whether it guides as soon as it has a field: a network waits until it knows more than a first snapshot does.
        self._guides = model.field is not None or not model.has_stand_in
        self._takes_over = False

    @property
    def is_over(self) -> bool:
        return self._standing.is_over or self._is_given_up

    @property
    def is_missed(self) -> bool:
        """Whether nothing can be guided yet for want of it."""
        return self._model.field is None and not self._model.has_stand_in

    @property
    def has_stand_in(self) -> bool:
        """Whether it guides, and the mixture field can do so instead."""
        return not self.is_over and self._guides and self._model.has_stand_in and self._model.field is not None

    @property
    def stands_alone(self) -> bool:
        """Whether it learns, and nothing else could guide in its place."""
        return not self.is_over and not self._model.has_stand_in

    @property
    def is_learning(self) -> bool:
        """Whether it guides, and has hardly been trained yet."""
        is_new = self._model.step_count < self._context.rules.source_doubtful_steps
        return self.has_stand_in and self._model.is_learning and is_new

    def has_taken_over(self) -> bool:
        """Whether it has begun to guide where its stand-in did, since this was last asked."""
        found, self._takes_over = self._takes_over, False
        return found

    def learn(self, iteration: Iteration) -> None:
        if self._regions.models is None:
            return
        context, model, started = self._context, self._model, time.perf_counter()
        model.learn(
            iteration.records, iteration.row_count, iteration.samples, iteration.traced.recorded_share,
            context.executor, context.thread_count,
        )
        if not model.is_asynchronous:
            context.report.field_seconds += (time.perf_counter() - started) * context.thread_count
        if not self._guides and model.field is not None:
            has_learned = model.step_count >= context.rules.source_least_steps or not model.is_learning
            self._guides = self._takes_over = has_learned
        self._describe()
        context.notices.extend(model.notices)
        model.notices.clear()

    def _describe(self) -> None:
        self._context.report.source, self._context.report.source_seconds = self._model.describe(), self._model.seconds

    def complete(self, guidance: Guidance, way: Way, image: ImageState) -> Guidance:
        if not way.is_guided or self._is_given_up or not self._guides:
            return guidance
        return replace(guidance, source=self._model.field)

    def rehearse(self, rehearsal: Rehearsal) -> None:
        self._model.rehearse(rehearsal.records, rehearsal.row_count, self._context.executor)

    def give_up(self, next_sample: int) -> None:
        """Leave guiding to the stand-in from a sample on."""
        self.stop()
        self._is_given_up = True
        self._context.report.source_stopped_at = next_sample

    def stop(self) -> None:
        if not self._is_given_up:
            self._model.close()
            self._describe()
