# SPDX-License-Identifier: GPL-3.0-or-later
"""Between the iterations of a guided render: what paths recorded becomes the next iteration's guidance.

The lengths of iterations are functions of their index alone. What is learned concerns distributions and candidate
counts, and which method goes on: every sample has the expected value of the image, whatever the earlier ones were.
Its weight may depend on these, and with a time limit the number of samples does. The bias that this leaves in the mean
is at most a few hundredths of its own standard error (docs/decisions/trial-and-choice.md).
"""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from engine.guiding.fields.state import check_numbers, part, prefixed
from engine.guiding.models.predictors import PREDICTORS, Predictor
from engine.guiding.models.regions import RegionModels, without_surfaces
from engine.guiding.models.report import GuidingReport
from engine.guiding.models.source_model import SourceModel
from engine.guiding.policy import trial
from engine.guiding.policy.cache_learning import CacheLearner
from engine.guiding.policy.cautious import CautiousTrial
from engine.guiding.policy.choice import Choice
from engine.guiding.policy.costs import IterationCosts, MethodCosts
from engine.guiding.policy.gate import Gate
from engine.guiding.policy.guidance import Guidance
from engine.guiding.policy.horizon import Horizon
from engine.guiding.policy.iterations import RecordBudget, is_narrow, iteration_weight
from engine.guiding.policy.ladder import Ladder
from engine.guiding.policy.media_trial import MEDIA, SURFACES, MediaTrial
from engine.guiding.policy.off_policy import HeldOut, hold_out, moments, predict, promised_efficiency
from engine.guiding.policy.request import NOTHING_ASKED, LearningRequest
from engine.guiding.policy.roulette_learning import RouletteElsewhere, RouletteModel, RouletteTrial
from engine.guiding.policy.trial import ComparedValues, NewestVariance, Part
from engine.guiding.policy.unguided_learning import learns_after, unguided_budget
from engine.guiding.policy.worth import ResamplingWorth
from engine.guiding.records.of_unit import UnitRecords
from engine.guiding.records.vertices import VertexRecords, allocate_vertex_records, compensate, join_records
from engine.guiding.saved.learned import LOST, LearnedField
from engine.guiding.sources import make_source_model
from engine.methods import METHODS, rungs_of
from engine.ris.orca import image_variance, make_allocation, pixel_weights
from engine.scene.description import Notice
from engine.settings import RenderSettings
from engine.state.film import FilmTile
from engine.state.lights import LightSelection, no_selection
from engine.state.unit import CHALLENGER, PLAIN, Unit, UnitCosts

#: Records that kernels of learning are rehearsed on.
_REHEARSED_RECORDS = 256


class Learner:
    """Owns what one render learns, and decides by it how the next iteration is rendered.

    Parameters
    ----------
    settings : RenderSettings
        With a guiding method.
    thread_count : int
    paths_per_sample : int
        Pixels of the image.
    unit_pixels : int, optional
        Of the largest unit of work; None: all.
    request : LearningRequest
    light_clusters : bool (C,), optional
        Which of the scene's clusters of lights can be sampled; None: nothing is learned about lights.
    trial_share : float
        Share of the pixels that units of a trial can have. Until guiding has been found to pay, it is tried on these
        alone.
    has_media : bool
        Whether the scene has media. Guiding seldom pays there: it is tried cautiously, from the fifth sample on, by
        what four unguided ones have left.

    Attributes
    ----------
    other_parts : list of Part
        Of the units that have no pixels of the trial, in the iteration in work; empty: all units have the same parts.
    """

    def __init__(
        self, settings: RenderSettings, thread_count: int, paths_per_sample: int, unit_pixels: int | None = None,
        request: LearningRequest = NOTHING_ASKED, light_clusters: npt.NDArray[np.bool_] | None = None,
        trial_share: float = 1.0, has_media: bool = False,
    ) -> None:
        self.settings = settings
        source, sink, start, rules = request.source, request.sink, request.start, request.rules
        self._rules = rules
        self._light_clusters = light_clusters
        #: None: nothing is learned about them.
        self._lights: LightSelection | None = None if light_clusters is None else no_selection()
        self.notices: list[Notice] = []
        self.sink = sink
        self._thread_count = thread_count
        self._paths_per_sample = paths_per_sample
        self._executor = ThreadPoolExecutor(thread_count, thread_name_prefix="learn")
        self._rungs = rungs_of(settings.method)
        self.report = GuidingReport(method=settings.guiding_method, chosen=self._rungs[0])
        self._source: SourceModel | None = make_source_model(settings) if source is None else source
        self._predictors = {
            name: PREDICTORS[name](settings, self.report, self.notices)
            for name in dict.fromkeys(METHODS[rung].predictor for rung in self._rungs)
        }
        # Where all that learns does so between iterations, and samples are given, the image depends on no clock.
        learns_beside = any(predictor.is_asynchronous for predictor in self._predictors.values())
        learns_beside |= self._source is not None and self._source.is_asynchronous
        self._uses_clock = (learns_beside or settings.time_limit > 0.0) and not settings.deterministic
        self._costs = MethodCosts(
            {rung: self._predictor(rung).candidate_costs for rung in self._rungs}, uses_clock=self._uses_clock,
            rules=rules,
        )
        self._choice = Choice(paths_per_sample, self._rungs[0], tries_plain=settings.guiding_trial, rules=rules)
        self.report.trials = self._choice.trials
        self._media_trial = MediaTrial(paths_per_sample, rules)
        self._ladder = Ladder(settings, self._rungs, self._predictors, self._choice, rules)
        self._worth = ResamplingWorth(rules)
        self._regions: RegionModels | None = None
        self._roulette = RouletteModel(rules) if settings.learns_roulette else None
        #: Of roulette without guiding, once that has lost; and whether it is in work.
        self._roulette_trial: RouletteTrial | None = None
        self._elsewhere: RouletteElsewhere | None = None
        #: Whether paths of the iteration in work end by what was learned.
        self._ends_by_learned = False
        self._newest = NewestVariance(paths_per_sample, rules)
        self._unit_pixels = unit_pixels or paths_per_sample
        self._budget = RecordBudget(paths_per_sample, self._unit_pixels, rules=rules)
        self._horizon = Horizon(settings, paths_per_sample, uses_clock=self._uses_clock, rules=rules)
        self._iteration = 0
        #: Whether roulette or lights are learned from the iteration in work, though guiding has lost.
        self._learns_on = False
        #: Whether the iteration in work is guided.
        self._is_guiding = False
        self._is_over = False
        self._learning_seconds = 0.0
        #: Where guiding is tried cautiously.
        self._cautious: CautiousTrial | None = None
        self._gate = self._make_gate()
        self._start = start
        self._keeps = request.keeps
        self._samples = self._ray_count = self._variance = self._brightness = 0.0
        if start is not None and start.verdict == LOST and settings.guiding_trial:
            # What guided badly would do so again until a trial ends it.
            self.report.lost_before = str(start)
            start = self._start = None
        if start is not None:
            self._resume(start)
        self._budget.is_frugal = self._is_doubtful
        first = self._predictor(self._rungs[0])
        # Who asks for a number of candidates gets what predicts at once.
        if self._gate is None and not self._ladder.is_auto and not first.has_begun:
            first.begin(1)
        #: Whether a sample weighs by whether it is guided, not by the samples seen before.
        self._weighs_arms = settings.guiding_trial and settings.sample_weighting != "UNIFORM" and start is None
        self._compared_values = ComparedValues(paths_per_sample)
        #: Samples elsewhere have to count as much as those that are guided, and nobody may ask for all records.
        is_apart = self._weighs_arms and self._source is None and sink is None and settings.radiance_cache == "OFF"
        self._trial_share = trial_share if is_apart else 1.0
        if has_media and is_apart:
            self._cautious = CautiousTrial(rules)
        if self._trial_share < 1.0 and self._roulette is not None and paths_per_sample <= rules.roulette_most_pixels:
            self._elsewhere = RouletteElsewhere(paths_per_sample, uses_clock=self._uses_clock, rules=rules)
        self.other_parts: list[Part] = []
        self._cache = None
        if settings.radiance_cache != "OFF":
            self._cache = CacheLearner(settings, paths_per_sample, self._unit_pixels, self.report, rules)

    def _make_gate(self) -> Gate | None:
        """What decides about the network, if there may be one and allocation judges resampling."""
        networks = [predictor for predictor in self._predictors.values() if predictor.is_asynchronous]
        if not networks or not self._ladder.counts_worth:
            return None
        caution = self._rules.auto_caution if self._ladder.is_auto else 1.0
        horizon = Horizon(
            self.settings, self._paths_per_sample, uses_clock=self._uses_clock, caution=caution,
            rules=self._rules,
        )
        # AUTO compares what is kept by rendered samples.
        return Gate(networks[0], self.report, horizon, judges_on=not self._ladder.is_auto, rules=self._rules)

    def _resume(self, start: LearnedField) -> None:
        """Take over what another render has learned."""
        regions = self._regions = RegionModels.of_state(
            start.state, self.settings.guiding_probability, start.field
        )
        self._begin_light_selection(regions)
        count = regions.mixture.region_count
        resumed = {
            name for name, predictor in self._predictors.items()
            if predictor.resume(part(start.state, predictor.part), count)
        }  # fmt: skip
        self._samples, self._ray_count = start.samples, start.ray_count
        self._variance, self._brightness = start.variance, start.brightness
        self._budget.records_per_path = start.records_per_path
        self._choice.resume(start.verdict, start.efficiency)
        is_known = start.rung in self._rungs and METHODS[start.rung].predictor in {"", *resumed}
        if self._ladder.is_auto and is_known:
            self._choice.rung = start.rung
        self.report.started_from = str(start)

    @property
    def known_samples(self) -> float:
        """Samples a pixel that the render knew about before its first."""
        return 0.0 if self._start is None else self._start.samples

    def learned(self, light_digest: str) -> LearnedField | None:
        """All that was learned so far of the scene of this digest, for other renders; None while there is nothing.

        Raises
        ------
        StateError
            If no render could start from it: light was so bright that sums of its squares are out of bounds.
        """
        if self._regions is None:
            return None
        choice, state = self._choice, self._regions.state()
        for predictor in self._predictors.values():
            state |= prefixed(predictor.part, predictor.state())
        check_numbers(state)
        return LearnedField(
            state,
            light_digest, choice.rung, LOST if self._is_over else choice.verdict,
            choice.efficiency if math.isfinite(choice.efficiency) else 0.0, self._samples,
            self._budget.records_per_path, self._ray_count, self._variance, self._brightness,
        )

    def _predictor(self, rung: str) -> Predictor:
        return self._predictors[METHODS[rung].predictor]

    def _probes_only(self, rung: str) -> bool:
        """Whether allocation is only tried: of the coarsest method, or for want of a predictor that it would be for."""
        if self._ladder.is_auto:
            return rung == self._rungs[0]
        return self._gate is not None and not self._gate.is_open

    def weight(self, first_sample: int, arm: int) -> float:
        """Weight in the image of each sample of an arm in the iteration that begins with `first_sample`."""
        if self._weighs_arms:
            is_guided = self._is_guiding and arm != PLAIN
            is_first = first_sample == self._rules.cautious_samples
            is_cautious = self._cautious is not None and (bool(self.other_parts) or is_first)
            return trial.tried_weight(first_sample, is_guided=is_guided, is_cautious=is_cautious, rules=self._rules)
        return self._grown_weight(first_sample, arm)

    def _grown_weight(self, first_sample: int, arm: int) -> float:
        """Weight of a sample by what was seen before."""
        weight = iteration_weight(first_sample, self.settings, self.known_samples, self._rules)
        return weight * self._rules.plain_weight if arm == PLAIN else weight

    @property
    def parts(self) -> list[Part]:
        """Parts of the iteration in work."""
        if self._roulette_trial is not None and self._roulette_trial.is_running:
            return self._roulette_trial.parts
        return self._media_trial.parts if self._media_trial.is_running else self._choice.parts

    @property
    def _pixel_share(self) -> float:
        """Share of the pixels that have guided samples in the iteration in work, if any have."""
        return self._trial_share if self.other_parts else 1.0

    @property
    def _guided_share(self) -> float:
        """Share of the samples of the iteration in work that are guided."""
        return self._choice.guided_share * self._pixel_share

    def _go_on_alike(
        self, recorded_share: float, sums: FilmTile, size: tuple[int, int], next_range: tuple[int, int]
    ) -> Guidance:
        """Learn nothing from an unguided iteration yet, and go on as before."""
        self._iteration += 1
        self._choice.skip(*next_range)
        # What guides directions learns nothing from the weights of unguided paths.
        weights = None if self._lights is None else self._weights(sums, size)
        guidance = Guidance(self.settings, int(recorded_share * 2**32), pixel_weight=weights, lights=self._lights)
        return self._completed(guidance, weights)

    def _weights(self, sums: FilmTile, size: tuple[int, int]) -> np.ndarray:
        """Of the pixels' variances, float32 (P,)."""
        if self._weighs_arms and not self._is_over:
            return self._compared_values.weights(size)
        mean = sums.radiance / np.maximum(sums.weight, 1e-20)[:, None]
        return pixel_weights(mean.reshape(*size, -1))

    @property
    def is_over(self) -> bool:
        """Whether guiding has been given up: there is nothing more to learn."""
        is_trying = self._roulette_trial is not None and self._roulette_trial.is_running
        return self._is_over and not (is_trying or self._learns_on) and (self._cache is None or self._cache.is_over)

    def first(self) -> Guidance:
        """Guidance of the first iteration: what the render starts from, else none, but record."""
        regions, source = self._regions, self._source
        lacks_source = source is not None and source.field is None and not source.has_stand_in
        if regions is None or lacks_source:
            samples = 1 if self._cautious is None else self._rules.cautious_samples
            return self._completed(Guidance(self.settings, self._budget.threshold(samples), lights=self._lights))
        # Of the image nothing is known but how bright it was.
        weight = pixel_weights(np.full((1, 1, 1), max(self._brightness, 1e-20), np.float32))
        return self._guidance(
            regions, regions.variance_deltas(), self._ray_count, self._variance,
            np.full(self._paths_per_sample, weight[0], np.float32), 1.0,
        )

    def _learn_unguided(
        self, units: Sequence[UnitRecords], path_count: float, sums: FilmTile, weights: np.ndarray,
        costs: IterationCosts,
    ) -> None:
        """Learn what unguided paths go by too, once guiding has lost: from what so many paths have recorded."""
        records, row_count = join_records([unit.vertices for unit in units])
        if not row_count:
            return
        self.report.record_count += row_count
        self._budget.count(row_count + costs.dropped_records, path_count)
        if self._roulette is not None:
            self._roulette.learn(records, row_count, sums, weights, costs)
        if self._lights is not None and self._regions is not None:
            self._regions.learn_lights(records, row_count)
            self._lights = self._regions.choose_lights()
            self.report.lights_share = self._regions.lights_share

    def _unguided(self, weights: np.ndarray, next_range: tuple[int, int]) -> Guidance:
        """What a render goes by once guiding has lost; whether roulette by what was learned pays is tried first."""
        guidance = self._without_guiding(weights, next_range)
        is_trying = self._roulette_trial is not None and self._roulette_trial.is_running
        lights_pay = self._lights is not None and self.report.lights_share > 0.0
        has_use = self.sink is None and sum(next_range) < self.settings.samples
        has_use &= guidance.reflected is not None or lights_pay
        has_use &= learns_after(next_range[0], lights_pay=lights_pay, rules=self._rules)
        self._learns_on = has_use and not is_trying
        if not self._learns_on:
            return guidance
        return replace(guidance, record_threshold=self._budget.threshold(next_range[1]))

    def _without_guiding(self, weights: np.ndarray, next_range: tuple[int, int]) -> Guidance:
        """The same, without records."""
        plain = Guidance(self.settings, 0, lights=self._lights)
        if self._roulette is None:
            return plain
        if self._roulette_trial is None:
            self._roulette_trial = RouletteTrial(
                self._paths_per_sample, next_range, uses_clock=self._uses_clock, elsewhere=self._elsewhere,
                rules=self._rules,
            )
            if self._roulette_trial.is_running:
                return replace(plain, challenger=self._roulette.complete(plain, weights))
        if self._roulette_trial.is_running or self._roulette_trial.is_known:
            self.report.trials.append(self._roulette_trial.judge(weights, next_range[0]))
        return self._roulette.complete(plain, weights) if self._roulette_trial.is_won else plain

    def _completed(self, guidance: Guidance, weights: np.ndarray | None = None) -> Guidance:
        """Guidance with what ends paths; `weights` are those of the film's pixels."""
        if self._roulette is not None:
            guidance = self._roulette.complete(guidance, weights)
        self._ends_by_learned = guidance.reflected is not None
        return guidance if self._cache is None else self._cache.complete(guidance)

    def begin(self) -> None:
        """Tracing begins."""
        self._horizon.begin()
        if self._gate is not None:
            self._gate.begin_clock()

    def narrow(self, pixel_count: int, expected_paths: float) -> None:
        """Take how many pixels the next iteration has, and how many paths they are expected to get in all."""
        self._budget.paths_per_sample = pixel_count
        self._choice.is_narrow = is_narrow(pixel_count, self._paths_per_sample, self._rules)
        if pixel_count < self._paths_per_sample:
            # Units are divided by which pixels go on.
            self._trial_share = 1.0
        expected = expected_paths / max(self._paths_per_sample, 1)
        self._horizon.expected_samples = expected
        if self._gate is not None:
            self._gate.expect(expected)

    def rehearse(self) -> Guidance:
        """Load (or compile) the kernels of learning by learning from nothing in particular.

        Returns
        -------
        Guidance
            Fit to call every guided stage with, on no lanes.
        """
        count = _REHEARSED_RECORDS
        rng = np.random.default_rng(0)
        records = allocate_vertex_records(count, self.settings.channel_count)
        direction = rng.normal(size=(count, 3))
        records.position[:] = rng.random((count, 3))
        records.direction[:] = direction / np.linalg.norm(direction, axis=1)[:, None]
        records.normal[:] = (0.0, 0.0, 1.0)
        for column in (records.radiance, records.pdf, records.distance, records.roughness):
            column[:] = 1.0
        regions = RegionModels.of_records(records, count, 0.5)
        self._begin_light_selection(regions)
        regions.fit(records, count)
        regions.learn_shares(records, count, variance=1.0, ray_count=1.0, was_guided=True)
        if self._source is not None:
            self._source.rehearse(records, count, self._executor)
        if self._cache is not None:
            self._cache.rehearse()
        if self._roulette is not None:
            self._roulette.rehearse()
        trial.rehearse(self.settings.channel_count)
        if self._gate is not None:
            held = hold_out(records, count, regions.field, regions.selection.probability, 1.0)
            for predictor in self._predictors.values():
                predict(predictor.rehearsal(regions.mixture), held.field, held.records, held.leaf)
        predictions = self._predictor(self._rungs[0]).rehearsal(regions.mixture)
        allocation = make_allocation(
            np.zeros(1, np.float32), ray_count=1.0, variance=1.0, costs=self._costs.candidates("")
        )
        ones = np.ones(1, np.float32)
        return Guidance(
            self.settings, 0, regions.field, ones, ones, ones, 1, allocation,
            np.ones(self._paths_per_sample, np.float32), predictions.table, predictions.network, predictions.session,
        )

    def learn(
        self, units: Sequence[UnitRecords], recorded_share: float, sums: FilmTile, size: tuple[int, int],
        costs: IterationCosts, next_range: tuple[int, int], *, is_whole: bool = True,
    ) -> Guidance:
        """Learn from an iteration, and say how to go on.

        Parameters
        ----------
        units : UnitRecords of each tile, in an order that does not depend on threads
        recorded_share : float, of the guided paths that were recorded
        sums : FilmTile, the image so far
        size : (int, int)
            Rows and columns of the image.
        costs : IterationCosts
        next_range : (int, int)
            First sample and samples a pixel of the next iteration.
        is_whole : bool
            Whether the next iteration's samples lie in all of u, not in a stratum.
        """
        if self._cautious is not None and self._cautious.is_early(next_range[0]):
            self._cautious.hold(units, sum(part.sample_count for part in self.parts), costs)
            return self._go_on_alike(recorded_share, sums, size, next_range)
        started = time.perf_counter()
        self._iteration += 1
        choice, settings = self._choice, self.settings
        is_last = sum(next_range) >= settings.samples and not self._keeps and self.sink is None and self._cache is None
        if self._source is None and self._cache is None:
            # Networks learn from all that there is.
            left = self._horizon.samples_left(next_range[0]) - next_range[1]
            self._budget.samples_left = 0.0 if is_last else max(left, 1.0)
        # In a trial a part of the samples only, and of the pixels.
        guided_share = self._guided_share
        samples = sum(part.sample_count for part in self.parts) * guided_share
        if self._cautious is not None:
            units, earlier_samples, costs = self._cautious.release(units, costs)
            samples += earlier_samples
        self._samples += samples
        weights = self._weights(sums, size)
        if not self._is_over:
            # What learning costs is compared with what guiding all pixels would.
            self._judge(weights, next_range[0], choice.guided_share * sum(costs.stage_seconds.values()))
            self._budget.is_frugal = self._is_doubtful
        self.other_parts = []
        if self._is_over:
            self._is_guiding = False
            choice.plan(*next_range, (), knows_something=False)
            if self._cache is None:
                self._learn_unguided(units, recorded_share * guided_share * costs.path_count, sums, weights, costs)
                return self._unguided(weights, next_range)
            guidance = self._cache.learn(units, recorded_share, sums, size, costs, next_range, is_whole=is_whole)
            return replace(guidance, lights=self._lights)
        was_guided, self._is_guiding = self._is_guiding, False
        ray_count = costs.ray_count / max(costs.path_count, 1)
        variance = image_variance(self._newest.look(), weights)
        if self._start is not None and self._iteration == 1:
            # One sample a pixel has none.
            variance = max(variance, self._variance)
        mean = sums.radiance / np.maximum(sums.weight, 1e-20)[:, None]
        self._ray_count, self._variance, self._brightness = ray_count, variance, float(mean.mean(dtype=np.float64))
        records, row_count = join_records([unit.vertices for unit in units])
        self.report.record_count += row_count
        self._judge_network(
            records, row_count, recorded_share * guided_share * costs.path_count, variance, ray_count, next_range[0]
        )
        if row_count:
            self._budget.count(row_count + costs.dropped_records, recorded_share * guided_share * costs.path_count)
            self._fit(records, row_count)
            if self._roulette is not None:
                self._roulette.learn(records, row_count, sums, weights, costs)
            if self._cache is not None:
                self._cache.take(units)
                self._cache.judge(sums, size, next_range[0])
        regions = self._regions
        if regions is None:
            choice.plan(*next_range, (), knows_something=False)
            return self._completed(Guidance(settings, self._budget.threshold(next_range[1])), weights)
        if row_count:
            regions.add_deltas(records, row_count)
        if costs.guided_vertices and self._ladder.is_probing:
            self._worth.count(costs, recorded_share)
        if self._gate is not None and choice.is_settled:
            self._gate.begin(next_range[0], regions.mixture.region_count)
        for predictor in self._predictors.values():
            predictor.learn(records, row_count, samples, self._iteration)
        self._learn_source(records, row_count, samples, recorded_share)
        if self.sink is not None:
            self.sink.take(records, row_count)

        if row_count:
            regions.learn_shares(
                records, row_count, variance=variance, ray_count=ray_count, was_guided=was_guided
            )
        if self._cautious is not None:
            while not self._is_over and self._is_doubtful and self._cautious.is_hopeless(
                self._promised(regions), choice.efficiency
            ):
                self._lose(next_range[0])
            self._cautious.weigh(self._promised(regions), choice.efficiency)
            self._budget.is_frugal = self._is_doubtful
        if self._light_clusters is not None:
            self._lights = regions.choose_lights()
            self.report.lights_share = regions.lights_share
        if self._is_over:
            choice.plan(*next_range, (), knows_something=False)
            return self._unguided(weights, next_range)
        delta = regions.variance_deltas()
        # Costs of an iteration that compares are those of two methods.
        if len(self.parts) == 1:
            self._costs.measure(choice.rung, costs)
        offers = self._ladder.offers(next_range[0], self._worth.is_worth_it, regions, self._gate)
        choice.plan(*next_range, offers, is_whole=is_whole, is_last=is_last)
        self._plan_media(regions, next_range, is_last=is_last)
        if self._trial_share < 1.0 and self._is_doubtful and not choice.is_settled:
            self.other_parts = [Part(*next_range, PLAIN)]
        self._learning_seconds = time.perf_counter() - started
        return self._guidance(regions, delta, ray_count, variance, weights, next_range[1] * choice.guided_share)

    def _plan_media(self, regions: RegionModels, next_range: tuple[int, int], *, is_last: bool) -> None:
        """Compare guiding surfaces and media apart in the next iteration, if nothing else is compared there."""
        choice = self._choice
        is_free = self.settings.guiding_trial and regions.knows_media and choice.is_settled and not choice.is_narrow
        is_free = is_free and len(choice.parts) == 1 and not is_last
        self._media_trial.plan(*next_range, is_free=is_free)
        if regions.knows_media:
            self.report.guides = self._media_trial.guided

    def _guidance(
        self, regions: RegionModels, delta: np.ndarray, ray_count: float, variance: float, weights: np.ndarray,
        samples: float,
    ) -> Guidance:
        """What the next iteration's guided samples go by, of which the pixels that have some have so many."""
        choice = self._choice
        self._is_guiding = True
        field = regions.field
        probability = regions.probability(is_learned=self.settings.learn_guiding_probability)
        self.report.chosen = choice.rung
        ready = field.is_ready != 0
        of_surfaces, of_media = probability[: len(ready)], probability[len(ready) :]
        self.report.guided_share = float((of_surfaces[ready] > 0.0).sum() / max(ready.sum(), 1))
        if len(of_media):
            self.report.guided_media_share = float((of_media[ready] > 0.0).sum() / max(ready.sum(), 1))

        def by(rung: str, guides: str, challenger: Guidance | None = None) -> Guidance:
            predictions = self._predictor(rung).predictions
            allocation = make_allocation(
                delta, ray_count=ray_count, variance=variance, costs=self._costs.candidates(rung)
            )
            return Guidance(
                self.settings, self._budget.threshold(samples, self._pixel_share), field,
                without_surfaces(probability, len(ready)) if guides == MEDIA else probability,
                regions.light_share.share, regions.selection.benefit, self._fixed_count(rung), allocation, weights,
                predictions.table, predictions.network, predictions.session, self._probes_only(rung),
                self._source.field if self._source is not None else None, challenger, lights=self._lights,
                guides_media=guides != SURFACES,
            )

        media = self._media_trial
        challenger = None
        if choice.challenger:
            challenger = by(choice.challenger, media.guided)
        elif media.is_running:
            challenger = by(choice.rung, media.challenger)
        return self._completed(by(choice.rung, media.guided, challenger), weights)

    def _fixed_count(self, rung: str) -> int:
        """Candidates of every vertex, 0 if they are allocated."""
        settings, method = self.settings, METHODS[rung]
        if self._ladder.is_auto:
            return 0
        if not method.resamples:
            return 1
        is_fixed = method.always_resamples or settings.candidate_allocation == "FIXED"
        return settings.candidate_count if is_fixed else 0

    @property
    def _is_doubtful(self) -> bool:
        """Whether guiding by the mixture field has not been found to pay: then few paths are recorded."""
        is_tried = self.settings.guiding_trial and self._source is None
        is_promising = self._cautious is not None and self._cautious.is_promising
        return is_tried and not (self._choice.is_paying or is_promising)

    @property
    def wants_last(self) -> bool:
        """Whether the last iteration's records are of use: to the sink, or to what outlives the render."""
        is_enough = self._last_share >= self._rules.least_last
        return self.sink is not None or (self._keeps and not self._is_over and is_enough)

    @property
    def _last_share(self) -> float:
        """Samples of the iteration in work as a share of all that will have been seen."""
        samples = sum(part.sample_count for part in self.parts) * self._guided_share
        return samples / max(self._samples + samples, 1e-9)

    def take_last(self, units: Sequence[UnitRecords]) -> None:
        """Take the records of the last iteration, which nothing in this render can be guided by."""
        if self._cautious is not None:
            units = [*self._cautious.held, *units]
        records, row_count = join_records([unit.vertices for unit in units])
        if self.sink is not None:
            self.sink.take(records, row_count)
        if self._keeps and not self._is_over and row_count and self._last_share >= self._rules.least_last:
            self._iteration += 1
            was_guided = self._is_guiding
            self._fit(records, row_count)
            assert self._regions is not None
            self._regions.add_deltas(records, row_count)
            self._regions.learn_shares(
                records, row_count, variance=self._variance, ray_count=max(self._ray_count, 1.0),
                was_guided=was_guided,
            )
            self._samples += sum(part.sample_count for part in self.parts) * self._guided_share

    def compare(self, unit: Unit, film: FilmTile, costs: UnitCosts) -> None:
        """Take a finished unit's sums and costs; no two threads at once."""
        if self._is_over:
            if self._roulette_trial is not None and self._roulette_trial.is_running:
                self._roulette_trial.compare(unit, film, self._costs.unit(costs, unit.arm, ""))
            return
        if self.other_parts and self._elsewhere is not None and self._choice.is_aside(unit):
            cost = self._costs.unit(costs, unit.arm, "")
            self._elsewhere.add(unit, film, cost, is_learned=self._ends_by_learned)
        if self._weighs_arms:
            weight = self._grown_weight(self.parts[0].first_sample, unit.arm)
            self._compared_values.add(unit.film_index, film.radiance, unit.sample_count, weight)
        if unit.arm != PLAIN and self._is_guiding:
            self._newest.add(unit.film_index, film.radiance, film.square, unit.sample_count)
        if self._media_trial.is_running:
            self._media_trial.compare(unit, film, self._costs.unit(costs, unit.arm, self._choice.rung))
            return
        rung = self._choice.challenger if unit.arm == CHALLENGER else self._choice.rung
        self._choice.compare(unit, film, self._costs.unit(costs, unit.arm, rung))

    def _judge(self, weights: np.ndarray, next_sample: int, tracing: float) -> None:
        """Conclude what the iteration compared, if it did. Its guided part took threads `tracing` seconds."""
        choice = self._choice
        overhead = 0.0
        if self._uses_clock:
            learning = 0.0 if choice.challenger else self._learning_seconds * self._thread_count
            training = self._predictor(choice.challenger).training_share(self._thread_count) if choice.challenger else 0
            overhead = learning / max(tracing, 1e-9) + training
        said = self._media_trial.judge(weights, next_sample)
        if said:
            choice.trials.append(said)
        left = self._horizon.samples_left(next_sample)
        choice.judge(
            weights, next_sample, overhead, left, is_part=bool(self.other_parts), is_cautious=self._cautious is not None
        )
        self.report.efficiency = choice.efficiency
        if not choice.has_lost:
            return
        source = self._source
        if source is not None and source.has_stand_in and source.field is not None:
            self._end_source()
            self._source = None
            self.report.source_stopped_at = next_sample
            # What stands in for it has long been learning: no more benefit of the doubt.
            choice.restart(trial.LAST_DOUBT)
        else:
            self._lose(next_sample)

    def _lose(self, next_sample: int) -> None:
        """Guide less, where that may pay; else give guiding up."""
        is_short = trial.is_short(next_sample, self._horizon.samples_left(next_sample), self._rules)
        if self._may_guide_less and not is_short and self._media_trial.fall_back():
            self._choice.restart(trial.LAST_DOUBT)
            return
        self._is_over = True
        self._budget = unguided_budget(
            self.settings, self._budget.paths_per_sample, self._unit_pixels, learns_lights=self._lights is not None,
            rules=self._rules,
        )
        self.report.stopped_at = next_sample
        self.report.chosen = "OFF"
        self._stop_training()

    def _promised(self, regions: RegionModels) -> tuple[float, ...]:
        """What regions promise of guiding what would be guided now, by kind of vertex."""
        surfaces, media = regions.promises
        return {SURFACES: (surfaces,), MEDIA: (media,)}.get(self._media_trial.guided, (surfaces, media))

    @property
    def _may_guide_less(self) -> bool:
        """Whether there are media, so that either they or surfaces can be left alone."""
        return self._regions is not None and self._regions.knows_media

    def _fit(self, records: VertexRecords, row_count: int) -> None:
        """Fit the mixture field, and the tables that learn from its batch."""
        settings = self.settings
        started = time.perf_counter()
        if settings.mis_compensation:
            records = compensate(records, row_count, settings.guiding_probability)
        if self._regions is None:
            self._regions = RegionModels.of_records(records, row_count, settings.guiding_probability)
            self._begin_light_selection(self._regions)
        elif self._start is not None and self._iteration == 1:
            self._regions.widen(records, row_count)
        self._regions.fit(records, row_count, self._executor, self._thread_count)
        for predictor in self._predictors.values():
            predictor.learn_regions(self._regions.mixture, self._executor, self._thread_count)
        field = self._regions.field
        self.report.region_count = len(field.is_ready)
        self.report.unsound_count = int(self._regions.mixture.report()["regions_unsound"])
        self.report.lobe_count = float(field.lobe_count.mean())
        self.report.field_seconds += (time.perf_counter() - started) * self._thread_count

    def _begin_light_selection(self, regions: RegionModels) -> None:
        if self._light_clusters is not None:
            regions.begin_light_selection(self._light_clusters)

    def _learn_source(
        self, records: VertexRecords, row_count: int, samples: float, recorded_share: float
    ) -> None:
        """Learn what directions are drawn from, if it is not the mixture field."""
        source = self._source
        if source is None:
            return
        started = time.perf_counter()
        had_field = source.field is not None
        source.learn(records, row_count, samples, recorded_share, self._executor, self._thread_count)
        if not source.is_asynchronous:
            self.report.field_seconds += (time.perf_counter() - started) * self._thread_count
        if source.has_stand_in and source.field is not None and not had_field:
            # What was tried so far was the mixture field.
            self._choice.restart(trial.BEFORE_FIRST)
        self.report.source, self.report.source_seconds = source.describe(), source.seconds
        self.notices.extend(source.notices)
        source.notices.clear()

    def _judge_network(
        self, records: VertexRecords, row_count: int, path_count: float, variance: float, ray_count: float,
        next_sample: int,
    ) -> None:
        """Tell the gate what the network promises over what is in use, by records that neither has learned from."""
        gate, regions = self._gate, self._regions
        if gate is None or regions is None:
            return
        promised = None
        if row_count and gate.wants_figure:
            probability = regions.probability(is_learned=self.settings.learn_guiding_probability)
            held = hold_out(records, row_count, regions.field, probability, path_count, self._rules)

            def promise(rung: str, predictor: Predictor) -> float:
                return self._promise(rung, predictor, held, variance, ray_count)

            rung = next(name for name in self._rungs if self._predictor(name) is gate.predictor)
            promised = promise(rung, gate.predictor)
            if METHODS[self._choice.rung].resamples and self._choice.rung != rung:
                promised /= promise(self._choice.rung, self._predictor(self._choice.rung))
            if self._uses_clock:
                promised /= 1.0 + gate.predictor.training_share(self._thread_count)
        gate.judge(next_sample, promised)

    def _promise(
        self, rung: str, predictor: Predictor, held: HeldOut, variance: float, ray_count: float
    ) -> float:
        """Efficiency over one candidate everywhere that held-out records promise of a method."""
        predicted = predict(predictor.predictions, held.field, held.records, held.leaf)
        found = moments(held, predicted, self.settings.defensive_alpha)
        return promised_efficiency(
            found, held.path_count, variance=variance, ray_count=ray_count, costs=self._costs.candidates(rung),
            rules=self._rules,
        )

    def close(self) -> None:
        """End the worker."""
        self._executor.shutdown(wait=True)
        self._stop_training()

    def _stop_training(self) -> None:
        """End all training."""
        for predictor in self._predictors.values():
            predictor.close()
        if self._source is not None:
            self._end_source()

    def _end_source(self) -> None:
        assert self._source is not None
        self._source.close()
        self.report.source = self._source.describe()
        self.report.source_seconds = self._source.seconds
