# SPDX-License-Identifier: GPL-3.0-or-later
"""Which method goes on? Finer ones are compared with what is in use, taken up, and left again.

With the method AUTO a finer method is tried where resampling promises to pay, once those before it have been compared,
and when its predictor is ready. What it needs is made then, and dropped as long as there is no use for it. A network is
offered where its gate is open, whatever resampling by coarser predictors promises.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from engine.guiding.models.predictors import Predictor
from engine.guiding.models.regions import RegionModels
from engine.guiding.policy.context import RenderContext
from engine.guiding.policy.costs import MethodCosts
from engine.guiding.policy.gate import Gate
from engine.guiding.policy.iteration import Iteration
from engine.guiding.policy.learnables.predictors import LearnedPredictors
from engine.guiding.policy.learnables.regions import LearnedRegions
from engine.guiding.policy.questions.question import Question
from engine.guiding.policy.resampling_gain import ResamplingGain
from engine.guiding.policy.rules import RULES, Rules
from engine.guiding.policy.staged import StagedVerdict, Verdict
from engine.guiding.policy.standing import Standing
from engine.guiding.policy.trial import ArmSamples, GuidingTrial, halves
from engine.guiding.policy.way import Way
from engine.methods import METHODS
from engine.settings import RenderSettings
from engine.state.film import FilmTile
from engine.state.unit import CHALLENGER, Unit


class MethodTrial:
    """The method in use, and the one that is compared with it.

    Parameters
    ----------
    pixel_count : int
    rung : str
        Method to begin with.
    rules : Rules

    Attributes
    ----------
    rung : str, in use
    challenger : str, method of the arm CHALLENGER, empty if there is none
    """

    def __init__(self, pixel_count: int, rung: str, rules: Rules = RULES) -> None:
        self.rung = rung
        self.challenger = ""
        self._pixel_count = pixel_count
        self._rules = rules
        self._trial: GuidingTrial | None = None
        self._verdict = StagedVerdict(rules)
        #: From which sample on methods may be tried again.
        self._not_before: dict[str, int] = {}

    def has_tried(self, method: str) -> bool:
        """Whether a method is in use, or has been compared."""
        return method == self.rung or method in self._not_before

    def has_use_for(self, method: str, next_sample: int) -> bool:
        """Whether a method is in use or being tried, or could be tried now."""
        return method in (self.rung, self.challenger) or next_sample >= self._not_before.get(method, 0)

    def compare(self, unit: Unit, film: FilmTile, cost: float) -> None:
        """Take a finished unit's sums and its cost, in any unit; no two threads at once."""
        if self._trial is not None:
            self._trial.add_unit(unit, film, cost, unit.arm == CHALLENGER)

    def judge(self, weights: np.ndarray, next_sample: int, overhead: float) -> str:
        """After an iteration: draw the conclusion, if it compared.

        Parameters
        ----------
        weights : float32 (P,), of the pixels' variances
        next_sample : int
        overhead : float
            Cost of what the challenger needs besides tracing, as a share of that.

        Returns
        -------
        str
            It in words, '' if there is none yet.
        """
        compared, self._trial = self._trial, None
        if compared is None:
            return ""
        found = self._verdict.take(compared.efficiency(weights) / (1.0 + overhead))
        if found is Verdict.GO_ON:
            return ""
        said = f"{self.challenger} over {self.rung} {self._verdict.mean:.2f} at sample {next_sample}"
        is_taken = found is Verdict.TAKEN
        self._not_before[self.rung if is_taken else self.challenger] = self._rules.again * next_sample
        if is_taken:
            self.rung = self.challenger
        self.challenger = ""
        return said

    def drop(self) -> None:
        """Go on with what is in use, whatever was being compared."""
        self.challenger, self._trial = "", None

    def plan(self, first: int, count: int, offers: Sequence[str]) -> list[ArmSamples]:
        """Parts of the next iteration, if it is to compare; else none.

        Parameters
        ----------
        first, count : int
            Its samples.
        offers : sequence of str
            Methods that could be tried, in the order in which to; one that is being tried must stay among them.
        """
        if count < self._rules.least_compared:
            return []
        if self.challenger not in offers:
            self.challenger = ""
        if not self.challenger:
            due = [rung for rung in offers if rung != self.rung and self.has_use_for(rung, first)]
            if not due:
                return []
            self.challenger = due[0]
            self._verdict = StagedVerdict(self._rules)
        # What is in use is guided too, and changes: samples of the iteration alone are compared.
        self._trial = GuidingTrial(self._pixel_count, rules=self._rules)
        return halves(first, count)


class Ladder:
    """Methods of a render, coarsest first.

    Parameters
    ----------
    settings : RenderSettings
    rungs : sequence of str
        More than one: a render by AUTO.
    predictors : mapping of str to Predictor
        By `Method.predictor`.
    rules : Rules
    """

    def __init__(
        self, settings: RenderSettings, rungs: Sequence[str], predictors: Mapping[str, Predictor],
        rules: Rules = RULES,
    ) -> None:
        self._rules = rules
        self._settings = settings
        self._rungs = tuple(rungs)
        self._predictors = predictors

    @property
    def coarsest(self) -> str:
        """The method to begin with."""
        return self._rungs[0]

    @property
    def is_auto(self) -> bool:
        """Whether methods are compared."""
        return len(self._rungs) > 1

    @property
    def counts_worth(self) -> bool:
        """Whether allocation judges resampling: not where a number of candidates is asked for."""
        return self._settings.candidate_allocation == "ORCA"

    def is_probing(self, choice: MethodTrial) -> bool:
        """Whether the coarsest method tries allocation in this iteration, to judge resampling by."""
        return self.is_auto and self.counts_worth and choice.rung == self._rungs[0] and not choice.challenger

    def offers(
        self, choice: MethodTrial, next_sample: int, is_worth_it: bool, regions: RegionModels, gate: Gate | None
    ) -> list[str]:
        """Methods to compare with the one in use, in the order in which to try them.

        Parameters
        ----------
        choice : MethodTrial
        next_sample : int
        is_worth_it : bool
            Whether enough vertices were worth several candidates.
        regions : RegionModels
        gate : Gate or None
            The network's.
        """
        coarsest = self._rungs[0]
        if not self.is_auto:
            return []
        is_promising = is_worth_it or choice.rung != coarsest or choice.challenger != ""
        offers = []
        is_reached = is_promising
        for rung in self._rungs[1:]:
            predictor = self._predictors[METHODS[rung].predictor]
            if predictor.is_asynchronous:
                is_ready = self._keep(choice, rung, predictor, next_sample) and gate is not None and gate.is_open
            else:
                is_ready = is_reached and self._prepare(choice, rung, predictor, next_sample, regions)
            if is_ready:
                offers.append(rung)
            is_reached = is_reached and choice.has_tried(rung)
        return [*offers, coarsest] if offers or is_promising else []

    def _keep(self, choice: MethodTrial, rung: str, predictor: Predictor, next_sample: int) -> bool:
        """Whether there is a use for what a rung needs; else drop it."""
        if choice.has_use_for(rung, next_sample):
            return True
        predictor.drop()
        return False

    def _prepare(
        self, choice: MethodTrial, rung: str, predictor: Predictor, next_sample: int, regions: RegionModels
    ) -> bool:
        """Make or drop what a rung needs; whether it can be tried."""
        if not METHODS[rung].predictor:
            return True
        if not self._keep(choice, rung, predictor, next_sample):
            return False
        if not predictor.has_begun:
            predictor.begin(regions.mixture.region_count)
            return False
        return predictor.is_ready and predictor.update_count >= self._rules.table_updates


class MethodQuestion(Question):
    """Which method goes on.

    Parameters
    ----------
    context : RenderContext
    standing : Standing
    regions : LearnedRegions
    predictors : LearnedPredictors
    costs : MethodCosts
    ladder : Ladder
    gate : Gate or None
        The network's.

    Attributes
    ----------
    trial : MethodTrial
    """

    def __init__(
        self, context: RenderContext, standing: Standing, regions: LearnedRegions, predictors: LearnedPredictors,
        costs: MethodCosts, ladder: Ladder, gate: Gate | None,
    ) -> None:
        self._context, self._standing, self._regions, self._predictors = context, standing, regions, predictors
        self._costs, self._ladder, self._gate = costs, ladder, gate
        self._gain = ResamplingGain(context.rules)
        self.trial = MethodTrial(context.pixel_count, ladder.coarsest, context.rules)

    @property
    def is_over(self) -> bool:
        return self._standing.is_over

    @property
    def is_comparing(self) -> bool:
        return self.trial.challenger != ""

    def observe(self, unit: Unit, film: FilmTile, cost: float, *, is_aside: bool) -> None:
        self.trial.compare(unit, film, cost)

    def conclude(self, iteration: Iteration) -> None:
        choice, costs, weights = self.trial, iteration.costs, iteration.image.weights
        if choice.challenger and weights is not None:
            overhead = 0.0
            if self._costs.uses_clock:
                overhead = self._predictors.of(choice.challenger).training_share(self._context.thread_count)
            said = choice.judge(weights, iteration.next_sample, overhead)
            if said:
                self._context.report.trials.append(said)
                self._context.report.chosen = choice.rung
        if costs.guided_vertices and self._ladder.is_probing(choice):
            self._gain.count(costs, iteration.traced.recorded_share)

    def plan(self, iteration: Iteration, *, is_free: bool) -> Sequence[ArmSamples]:
        choice, models = self.trial, self._regions.models
        offers: list[str] = []
        if models is not None:
            # Costs of an iteration that compares are those of two methods.
            if len(iteration.arms) == 1:
                self._costs.measure(choice.rung, iteration.costs)
            offers = self._ladder.offers(choice, iteration.next_sample, self._gain.is_worth_it, models, self._gate)
        if self._standing.is_narrow or iteration.is_next_last:
            choice.drop()
            return ()
        return choice.plan(*iteration.next_range, offers) if is_free else ()

    def way(self, way: Way) -> Way:
        return self._by(way, self.trial.rung)

    def challenge(self, way: Way) -> Way:
        return self._by(way, self.trial.challenger)

    def _by(self, way: Way, rung: str) -> Way:
        """The same by a method: allocation is only tried of the coarsest one, where they are compared."""
        return replace(way, rung=rung, probes_only=self._ladder.is_auto and rung == self._ladder.coarsest)
