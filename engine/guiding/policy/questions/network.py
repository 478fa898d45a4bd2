# SPDX-License-Identifier: GPL-3.0-or-later
"""Is a network worth it? Records that it has not learned from say what it promises; nothing is rendered for that."""

from __future__ import annotations

from dataclasses import replace

from engine.guiding.models.predictors import Predictor
from engine.guiding.policy.context import RenderContext
from engine.guiding.policy.costs import MethodCosts
from engine.guiding.policy.gate import Gate
from engine.guiding.policy.iteration import Iteration
from engine.guiding.policy.learnables.predictors import LearnedPredictors
from engine.guiding.policy.learnables.regions import LearnedRegions
from engine.guiding.policy.off_policy import HeldOut, hold_out, moments, predict, promised_efficiency
from engine.guiding.policy.questions.guiding import GuidingQuestion
from engine.guiding.policy.questions.method import MethodQuestion
from engine.guiding.policy.questions.question import Question
from engine.guiding.policy.standing import Standing
from engine.guiding.policy.way import Way
from engine.methods import METHODS


class NetworkQuestion(Question):
    """Whether a network is trained, and whether it may weigh candidates.

    Parameters
    ----------
    context : RenderContext
    standing : Standing
    regions : LearnedRegions
    predictors : LearnedPredictors
    costs : MethodCosts
    gate : Gate
    guiding : GuidingQuestion
        Nothing is trained before that is settled.
    method : MethodQuestion
    is_alone : bool
        Whether no methods are compared, so that the gate alone says whether the network is asked.
    """

    def __init__(
        self, context: RenderContext, standing: Standing, regions: LearnedRegions, predictors: LearnedPredictors,
        costs: MethodCosts, gate: Gate, guiding: GuidingQuestion, method: MethodQuestion, *, is_alone: bool,
    ) -> None:
        self._context, self._standing, self._regions, self._predictors = context, standing, regions, predictors
        self._costs, self._gate, self._guiding, self._method = costs, gate, guiding, method
        self._is_alone = is_alone
        self._rung = predictors.networks[0][0]

    @property
    def is_over(self) -> bool:
        return self._standing.is_over

    def begin(self) -> None:
        self._gate.begin_clock()

    def narrow(self, pixel_count: int, expected_samples: float) -> None:
        self._gate.expect(expected_samples)

    def way(self, way: Way) -> Way:
        return replace(way, probes_only=not self._gate.is_open) if self._is_alone else way

    def conclude(self, iteration: Iteration) -> None:
        """Take what the network promises over what is in use; begin to train one where that can pay."""
        gate, models = self._gate, self._regions.models
        if models is None:
            return
        promised = None
        if iteration.row_count and gate.wants_figure:
            probability = models.probability(is_learned=self._context.settings.learn_guiding_probability)
            held = hold_out(
                iteration.records, iteration.row_count, models.field, probability, iteration.path_count,
                self._context.rules,
            )
            promised = self._promise(self._rung, gate.predictor, held, iteration)
            in_use = self._method.trial.rung
            if METHODS[in_use].resamples and in_use != self._rung:
                promised /= self._promise(in_use, self._predictors.of(in_use), held, iteration)
            if self._costs.uses_clock:
                promised /= 1.0 + gate.predictor.training_share(self._context.thread_count)
        gate.judge(iteration.next_sample, promised)
        if self._guiding.is_settled:
            gate.begin(iteration.next_sample, models.mixture.region_count)

    def _promise(self, rung: str, predictor: Predictor, held: HeldOut, iteration: Iteration) -> float:
        """Efficiency over one candidate everywhere that held-out records promise of a method."""
        predicted = predict(predictor.predictions, held.field, held.records, held.leaf)
        found = moments(held, predicted, self._context.settings.defensive_alpha)
        return promised_efficiency(
            found, held.path_count, variance=iteration.image.variance, ray_count=iteration.image.ray_count,
            costs=self._costs.candidates(rung), rules=self._context.rules,
        )
