# SPDX-License-Identifier: GPL-3.0-or-later
"""What weighs the candidates of resampling: a table by region, a network, or the mixture field alone."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

from engine.guiding.fields.state import State, part, prefixed
from engine.guiding.models.predictors import PREDICTORS, Predictor
from engine.guiding.policy.context import RenderContext
from engine.guiding.policy.guidance import Guidance
from engine.guiding.policy.iteration import Iteration
from engine.guiding.policy.learnables.learnable import Learnable, Rehearsal
from engine.guiding.policy.learnables.regions import LearnedRegions, rehearsed_regions
from engine.guiding.policy.off_policy import hold_out, predict
from engine.guiding.policy.standing import Standing
from engine.guiding.policy.way import ImageState, Way
from engine.methods import METHODS


class LearnedPredictors(Learnable):
    """The predictors of all methods that a render may go by.

    Parameters
    ----------
    context : RenderContext
    standing : Standing
    regions : LearnedRegions
    rungs : sequence of str
        Methods of the render, coarsest first.

    Attributes
    ----------
    by_name : mapping of str to Predictor
        By `Method.predictor`.
    """

    def __init__(
        self, context: RenderContext, standing: Standing, regions: LearnedRegions, rungs: Sequence[str]
    ) -> None:
        self._context, self._standing, self._regions, self._rungs = context, standing, regions, tuple(rungs)
        self.by_name: Mapping[str, Predictor] = {
            name: PREDICTORS[name](context.settings, context.report, context.notices)
            for name in dict.fromkeys(METHODS[rung].predictor for rung in rungs)
        }

    @property
    def is_over(self) -> bool:
        return self._standing.is_over

    @property
    def networks(self) -> list[tuple[str, Predictor]]:
        """Those that a process of its own trains, each with its method."""
        found = [(rung, self.of(rung)) for rung in self._rungs]
        return [(rung, predictor) for rung, predictor in found if predictor.is_asynchronous]

    def of(self, rung: str) -> Predictor:
        """What weighs a method's candidates."""
        return self.by_name[METHODS[rung].predictor]

    def resume(self, state: State, region_count: int) -> set[str]:
        """Take over what another render has learned; returns the names of those that have."""
        return {
            name for name, predictor in self.by_name.items()
            if predictor.resume(part(state, predictor.part), region_count)
        }  # fmt: skip

    def follow_regions(self) -> None:
        """Learn from the batch that the mixture field was fitted to."""
        models = self._regions.models
        assert models is not None
        for predictor in self.by_name.values():
            predictor.learn_regions(models.mixture, self._context.executor, self._context.thread_count)

    def learn(self, iteration: Iteration) -> None:
        if self._regions.models is None:
            return
        if iteration.row_count:
            self.follow_regions()
        for predictor in self.by_name.values():
            predictor.learn(iteration.records, iteration.row_count, iteration.samples, iteration.index)

    def complete(self, guidance: Guidance, way: Way, image: ImageState) -> Guidance:
        if not way.is_guided:
            return guidance
        predictions = self.of(way.rung).predictions
        return replace(
            guidance, candidate_count=self._fixed_count(way.rung), probes_only=way.probes_only,
            table=predictions.table, model=predictions.model,
        )

    def _fixed_count(self, rung: str) -> int:
        """Candidates of every vertex, 0 if they are allocated."""
        settings, method = self._context.settings, METHODS[rung]
        if len(self._rungs) > 1:
            return 0
        if not method.resamples:
            return 1
        is_fixed = method.always_resamples or settings.candidate_allocation == "FIXED"
        return settings.candidate_count if is_fixed else 0

    def state(self) -> State:
        found: State = {}
        for predictor in self.by_name.values():
            found |= prefixed(predictor.part, predictor.state())
        return found

    def rehearse(self, rehearsal: Rehearsal) -> None:
        if not self.networks:
            return
        regions = rehearsed_regions(rehearsal)
        held = hold_out(rehearsal.records, rehearsal.row_count, regions.field, regions.selection.probability, 1.0)
        for predictor in self.by_name.values():
            predict(predictor.rehearsal(regions.mixture), held.field, held.records, held.leaf)

    def stop(self) -> None:
        for predictor in self.by_name.values():
            predictor.close()
