# SPDX-License-Identifier: GPL-3.0-or-later
"""What a render learns and asks: guided, with a radiance cache alone, or of roulette and lights alone.

The order of learnables is that in which they learn, the order of questions their precedence. A new one of either is a
line in its list.
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from engine.guiding.models.report import GuidingReport
from engine.guiding.policy.agenda import Agenda
from engine.guiding.policy.cautious import CautiousTrial
from engine.guiding.policy.conductor import Conductor
from engine.guiding.policy.context import RenderContext
from engine.guiding.policy.costs import MethodCosts
from engine.guiding.policy.evidence import Evidence
from engine.guiding.policy.gate import Gate
from engine.guiding.policy.iterations import RecordBudget
from engine.guiding.policy.keeping import FieldKeeper
from engine.guiding.policy.learnables.cache import LearnedCache
from engine.guiding.policy.learnables.learnable import Learnable
from engine.guiding.policy.learnables.lights import LightsAlone, LightsOfRegions
from engine.guiding.policy.learnables.predictors import LearnedPredictors
from engine.guiding.policy.learnables.regions import LearnedRegions
from engine.guiding.policy.learnables.roulette import LearnedRoulette
from engine.guiding.policy.learnables.sink import Handed
from engine.guiding.policy.learnables.source import LearnedSource
from engine.guiding.policy.metered import MeteredExecutor
from engine.guiding.policy.questions.cache import CacheQuestion
from engine.guiding.policy.questions.guiding import GuidingQuestion
from engine.guiding.policy.questions.media import MediaQuestion
from engine.guiding.policy.questions.method import Ladder, MethodQuestion
from engine.guiding.policy.questions.network import NetworkQuestion
from engine.guiding.policy.questions.question import Question
from engine.guiding.policy.questions.roulette import RouletteQuestion
from engine.guiding.policy.recording import BehindCache, CacheRecording, GuidedRecording, Recording, UnguidedRecording
from engine.guiding.policy.remaining_samples import RemainingSamples
from engine.guiding.policy.request import NOTHING_ASKED, LearningRequest
from engine.guiding.policy.sample_weights import GrowingWeights, SampleWeights, TrialWeights
from engine.guiding.policy.standing import Standing
from engine.guiding.policy.trial import ComparedValues, NewestVariance
from engine.guiding.saved.learned import LOST, LearnedField
from engine.guiding.sources import make_source_model
from engine.methods import METHODS, rungs_of
from engine.settings import RenderSettings


def make_learner(
    settings: RenderSettings, thread_count: int, pixel_count: int, unit_pixels: int | None = None,
    request: LearningRequest = NOTHING_ASKED, light_clusters: npt.NDArray[np.bool_] | None = None,
    trial_share: float = 1.0, *, has_media: bool = False,
) -> Conductor | None:
    """What learns in a render by these settings; None: nothing does. Parameters are those of `RenderContext`."""
    is_needed = settings.is_guided or settings.radiance_cache != "OFF" or settings.learns_roulette
    if not is_needed and light_clusters is None:
        return None
    report = GuidingReport(method=settings.guiding_method if settings.is_guided else "OFF")
    context = RenderContext(
        settings, thread_count, pixel_count, unit_pixels or pixel_count, request, light_clusters, trial_share,
        has_media, report, executor=MeteredExecutor(thread_count, thread_name_prefix="learn"),
    )
    if settings.is_guided:
        return _Guided(context).conductor()
    if settings.radiance_cache != "OFF":
        return _cached(context)
    return _unguided(context)


def _unguided(context: RenderContext) -> Conductor:
    """Learns which paths to end and which lights to sample. A few samples a pixel teach enough."""
    roulette = LearnedRoulette(context, context.rules.learned_samples) if context.settings.learns_roulette else None
    lights = None if context.light_clusters is None else LightsAlone(context)
    learnables: list[Learnable | None] = [roulette, lights]
    recording = UnguidedRecording(context, context.pixel_count, lights, roulette, after_guiding=False)
    return _without_guiding(context, learnables, [], SampleWeights(), recording)


def _cached(context: RenderContext) -> Conductor:
    """Learns a radiance cache."""
    standing = Standing()
    learnables: list[Learnable | None] = [LearnedCache(context, standing)]
    questions: list[Question] = [CacheQuestion(context, standing)]
    weights = GrowingWeights(context.settings, rules=context.rules)
    return _without_guiding(
        context, learnables, questions, weights, CacheRecording(context, _budget(context), standing)
    )


def _without_guiding(
    context: RenderContext, learnables: list[Learnable | None], questions: list[Question], weights: SampleWeights,
    recording: Recording,
) -> Conductor:
    standing = Standing(is_over=True)
    remaining = RemainingSamples(context.settings, context.pixel_count, uses_clock=False, rules=context.rules)
    evidence = Evidence(remaining, context.settings.samples, weights, standing)
    return Conductor(
        context, standing, [one for one in learnables if one is not None], Agenda(questions), evidence,
        MethodCosts({}, uses_clock=False, rules=context.rules), recording,
    )


def _budget(context: RenderContext) -> RecordBudget:
    return RecordBudget(context.pixel_count, context.unit_pixels, rules=context.rules)


class _Guided:
    """What a guided render learns and asks, while it is put together."""

    def __init__(self, context: RenderContext) -> None:
        settings, request, report = context.settings, context.request, context.report
        start = request.start
        if start is not None and start.verdict == LOST and settings.guiding_trial:
            # What guided badly would do so again until a trial ends it.
            report.lost_before = str(start)
            start = None
        self.context, self.start, self.standing, self.cache_standing = context, start, Standing(), Standing()
        self.rungs = rungs_of(settings.method)
        report.chosen = self.rungs[0]
        model = make_source_model(settings) if request.source is None else request.source
        # Costs need what predicts, and regions go by costs.
        self.costs = MethodCosts({}, uses_clock=False, rules=context.rules)
        self.regions = LearnedRegions(context, self.standing, self.costs)
        self.predictors = LearnedPredictors(context, self.standing, self.regions, self.rungs)
        self.source = None if model is None else LearnedSource(context, self.standing, self.regions, model)
        # Where all that learns does so between iterations, and samples are given, the image depends on no clock.
        learns_beside = bool(self.predictors.networks) or (model is not None and model.is_asynchronous)
        self.uses_clock = (learns_beside or settings.time_limit > 0.0) and not settings.deterministic
        self.costs.begin(
            {rung: self.predictors.of(rung).candidate_costs for rung in self.rungs}, uses_clock=self.uses_clock
        )
        self.has_cache = settings.radiance_cache != "OFF"
        #: Whether a sample weighs by whether it is guided, not by the samples seen before.
        self.weighs_arms = settings.guiding_trial and settings.sample_weighting != "UNIFORM" and start is None
        # Samples outside the trial have to count as much as those that are guided, and nobody may ask for all records:
        # cells need them early. In media guiding loses more than they would gain.
        needs_records = request.sink is not None or (self.has_cache and not context.has_media)
        is_new = model is None or (model.has_stand_in and model.is_asynchronous)
        is_apart = self.weighs_arms and is_new and not needs_records
        self.trial_share = context.trial_share if is_apart else 1.0
        self.cautious = CautiousTrial(context.rules) if context.has_media and is_apart else None
        self.remaining = self._remaining()

    def _remaining(self, caution: float = 1.0) -> RemainingSamples:
        context = self.context
        return RemainingSamples(
            context.settings, context.pixel_count, uses_clock=self.uses_clock, caution=caution, rules=context.rules
        )

    def _gate(self, ladder: Ladder) -> Gate | None:
        """What decides about the network, if there may be one and allocation judges resampling."""
        networks, rules = self.predictors.networks, self.context.rules
        if not networks or not ladder.counts_worth:
            return None
        remaining = self._remaining(rules.auto_caution if ladder.is_auto else 1.0)
        # AUTO compares what is kept by rendered samples.
        return Gate(networks[0][1], self.context.report, remaining, judges_on=not ladder.is_auto, rules=rules)

    def conductor(self) -> Conductor:
        """All of it together."""
        context, standing, regions, predictors = self.context, self.standing, self.regions, self.predictors
        settings, rules = context.settings, context.rules
        resumed: set[str] = set()
        if self.start is not None:
            regions.resume(self.start)
            assert regions.models is not None
            resumed = predictors.resume(self.start.state, regions.models.mixture.region_count)
        ladder = Ladder(settings, self.rungs, predictors.by_name, rules)
        gate = self._gate(ladder)
        cache_standing = self.cache_standing if self.has_cache else None
        roulette = LearnedRoulette(context, cache=cache_standing) if settings.learns_roulette else None
        lights = None if context.light_clusters is None else LightsOfRegions(context, standing, regions)
        method = MethodQuestion(
            context, standing, regions, predictors, self.costs, ladder, gate
        )
        media = MediaQuestion(context, standing, regions)
        guiding = GuidingQuestion(
            context, standing, regions, self.source, method, media, self.cautious, uses_clock=self.uses_clock,
            trial_share=self.trial_share,
        )
        learnables: list[Learnable | None] = [
            regions,
            roulette,
            LearnedCache(context, self.cache_standing) if self.has_cache else None,
            predictors,
            self.source,
            None if context.request.sink is None else Handed(context.request.sink, standing, regions),
            lights,
        ]
        questions: list[Question | None] = [
            guiding,
            method,
            None if gate is None else NetworkQuestion(
                context, standing, regions, predictors, self.costs, gate, guiding, method, is_alone=not ladder.is_auto
            ),
            media,
            None if roulette is None else RouletteQuestion(
                context, standing, roulette, keeps_outside_trial=self.trial_share < 1.0, uses_clock=self.uses_clock,
                cache=cache_standing,
            ),
            CacheQuestion(context, self.cache_standing) if self.has_cache else None,
        ]  # fmt: skip
        evidence = self._evidence()
        first_samples = 1 if self.cautious is None else rules.cautious_samples
        recording = GuidedRecording(context, _budget(context), guiding, first_samples, self.source, cache_standing)

        def rest(paths_per_sample: int) -> Recording:
            if not self.has_cache:
                return UnguidedRecording(context, paths_per_sample, lights, roulette, after_guiding=True)
            budget = RecordBudget(paths_per_sample, context.unit_pixels, rules=rules)
            cached = CacheRecording(context, budget, self.cache_standing)
            if roulette is None:
                return cached
            behind = UnguidedRecording(context, paths_per_sample, None, roulette, after_guiding=True)
            return BehindCache(context, cached, behind, self.cache_standing)

        if self.start is not None:
            self._resume(self.start, guiding, method, recording, resumed, is_auto=ladder.is_auto)
        first = predictors.of(self.rungs[0])
        # Who asks for a number of candidates gets what predicts at once.
        if gate is None and not ladder.is_auto and not first.has_begun:
            first.begin(1 if regions.models is None else regions.models.mixture.region_count)
        return Conductor(
            context, standing, [one for one in learnables if one is not None],
            Agenda([one for one in questions if one is not None]), evidence, self.costs, recording, rest,
            FieldKeeper(context, evidence, regions, predictors, guiding, method, self.cautious),
        )

    def _evidence(self) -> Evidence:
        """What samples say, and weigh."""
        context, settings, rules = self.context, self.context.settings, self.context.rules
        weights: SampleWeights
        if self.weighs_arms:
            weights = TrialWeights(settings, is_cautious=self.cautious is not None, rules=rules)
        else:
            weights = GrowingWeights(settings, 0.0 if self.start is None else self.start.samples, rules)
        outlives = context.request.is_for_later or self.has_cache
        evidence = Evidence(
            self.remaining, math.inf if outlives else settings.samples, weights, self.standing,
            NewestVariance(context.pixel_count, rules),
            ComparedValues(context.pixel_count) if self.weighs_arms else None, self.cautious,
        )
        if self.start is not None:
            evidence.resume(self.start, context.pixel_count)
        return evidence

    def _resume(
        self, start: LearnedField, guiding: GuidingQuestion, method: MethodQuestion, recording: Recording,
        resumed: set[str], *, is_auto: bool,
    ) -> None:
        """Begin with what another render has found out."""
        recording.budget.records_per_path = start.records_per_path
        guiding.trial.resume(start.verdict, start.efficiency)
        is_known = start.rung in self.rungs and METHODS[start.rung].predictor in {"", *resumed}
        if is_auto and is_known:
            method.trial.rung = start.rung
        self.context.report.started_from = str(start)
