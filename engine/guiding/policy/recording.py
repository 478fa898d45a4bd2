# SPDX-License-Identifier: GPL-3.0-or-later
"""How many paths record, for how long, and by what their contributions are weighed: guidance that holds nothing yet."""

from __future__ import annotations

from engine.guiding.policy.agenda import Agenda
from engine.guiding.policy.context import RenderContext
from engine.guiding.policy.guidance import Guidance
from engine.guiding.policy.iteration import Iteration
from engine.guiding.policy.iterations import RecordBudget
from engine.guiding.policy.learnables.lights import LightsAlone, LightsOfRegions
from engine.guiding.policy.learnables.roulette import LearnedRoulette
from engine.guiding.policy.learnables.source import LearnedSource
from engine.guiding.policy.questions.guiding import GuidingQuestion
from engine.guiding.policy.rules import RULES, Rules
from engine.guiding.policy.standing import Standing
from engine.settings import RenderSettings


class Recording:
    """How many paths record.

    Parameters
    ----------
    context : RenderContext
    budget : RecordBudget

    Attributes
    ----------
    budget : RecordBudget
    is_over : bool
        Whether there is nothing to learn any more, so that the render need not go in iterations.
    """

    def __init__(self, context: RenderContext, budget: RecordBudget) -> None:
        self._context, self.budget = context, budget
        self.is_over = False

    def count(self, iteration: Iteration) -> None:
        """Take how many records came of an iteration."""
        self._count(iteration, iteration.row_count)

    def _count(self, iteration: Iteration, row_count: int) -> None:
        self._context.report.record_count += row_count
        if row_count:
            self.budget.count(row_count + iteration.costs.dropped_records, iteration.path_count)

    def first(self) -> Guidance:
        """Guidance of the first iteration."""
        return Guidance(self._context.settings, self.budget.threshold(1))

    def next(self, iteration: Iteration, agenda: Agenda) -> Guidance:
        """Guidance of the iteration that the agenda has planned, after another; says whether it is over."""
        return Guidance(self._context.settings, self.budget.threshold(iteration.next_range[1]))


class GuidedRecording(Recording):
    """How many guided paths record.

    Parameters
    ----------
    context : RenderContext
    budget : RecordBudget
    guiding : GuidingQuestion
        Few are wanted while that is in doubt.
    first_samples : int
        A pixel, that are recorded before anything is learned.
    source : LearnedSource or None
        What directions are drawn from, if not the mixture field: it learns however little is left of the render.
    cache : Standing or None
        The radiance cache's, which does so too.
    """

    def __init__(
        self, context: RenderContext, budget: RecordBudget, guiding: GuidingQuestion, first_samples: int,
        source: LearnedSource | None, cache: Standing | None,
    ) -> None:
        super().__init__(context, budget)
        self._guiding, self._first_samples, self._source, self._cache = guiding, first_samples, source, cache
        #: Whether the source wants records however little is left of the render.
        self._needs_all = source is not None

    def first(self) -> Guidance:
        settings = self._context.settings
        self.budget.is_frugal = self._guiding.is_doubtful
        if settings.time_limit == 0.0:  # Else nobody knows how many samples it has time for.
            self.budget.samples_to_come = float(max(settings.samples - self._first_samples, 0))
        return Guidance(settings, self.budget.threshold(self._first_samples))

    def next(self, iteration: Iteration, agenda: Agenda) -> Guidance:
        settings, budget = self._context.settings, self.budget
        if iteration.is_early:
            weights = None if self._context.light_clusters is None else iteration.image.weights
            return Guidance(settings, int(iteration.traced.recorded_share * 2**32), pixel_weight=weights)
        budget.samples_to_come = max(iteration.samples_left - iteration.next_range[1], 0.0)
        budget.is_for_image = not self._needs_all and (self._cache is None or self._cache.is_over)
        if self._source is not None and self._source.is_over:
            # From the next iteration on: what stands in for the source has learned from all of this one.
            self._needs_all = False
        budget.is_frugal = self._guiding.is_doubtful
        if budget.is_for_image and iteration.is_next_last:
            return Guidance(settings, 0)
        threshold = budget.threshold(iteration.next_range[1] * agenda.guided_share, agenda.pixel_share)
        has_cache = self._cache is not None and not self._cache.is_over
        # What outlives the render is to know as much as it can.
        if has_cache and not self._context.request.is_for_later:
            rules = self._context.rules
            threshold = threshold_beside_cache(threshold, iteration.next_sample, rules.cache_recorded_share, rules)
        return Guidance(settings, threshold)


class UnguidedRecording(Recording):
    """How many paths record where roulette or lights are learned, and nothing is guided: for a few samples a pixel.

    Parameters
    ----------
    context : RenderContext
    paths_per_sample : int
        Pixels that are rendered.
    lights : LightsAlone, LightsOfRegions or None
    roulette : LearnedRoulette or None
        Whose paths have to record.
    after_guiding : bool
        Whether guiding has been given up before: then only what pays is learned on.
    """

    def __init__(
        self, context: RenderContext, paths_per_sample: int, lights: LightsAlone | LightsOfRegions | None,
        roulette: LearnedRoulette | None, *, after_guiding: bool,
    ) -> None:
        super().__init__(
            context,
            unguided_budget(
                context.settings, paths_per_sample, context.unit_pixels, learns_lights=lights is not None,
                rules=context.rules,
            ),
        )
        self._lights, self._roulette, self._after_guiding = lights, roulette, after_guiding

    def first(self) -> Guidance:
        # What a sample brings to a pixel is judged by the pixel's value, which nobody knows: no lights are learned yet.
        return Guidance(self._context.settings, 0 if self._roulette is None else self.budget.threshold(1))

    def next(self, iteration: Iteration, agenda: Agenda) -> Guidance:
        settings, rules = self._context.settings, self._context.rules
        lights_pay = self._lights is not None and self._lights.pays
        goes_on = learns_after(iteration.next_sample, lights_pay=lights_pay, rules=rules)
        if self._after_guiding:
            is_comparing = agenda.challenger is not None
            has_use = self._context.request.sink is None and sum(iteration.next_range) < settings.samples
            has_roulette = self._roulette is not None and self._roulette.is_ready and agenda.way.ends_by_learned
            goes_on = goes_on and has_use and (has_roulette or lights_pay) and not is_comparing
            self.is_over = not (goes_on or is_comparing)
        else:
            self.is_over = not goes_on
        threshold = self.budget.threshold(iteration.next_range[1]) if goes_on else 0
        # Lights are learned by what samples bring to their pixels: without weights they would be forgotten.
        return Guidance(settings, threshold, pixel_weight=iteration.image.weights)


class CacheRecording(Recording):
    """How many paths teach the radiance cache, where nothing is guided.

    Parameters
    ----------
    context : RenderContext
    budget : RecordBudget
    standing : Standing
        The cache's.
    """

    def __init__(self, context: RenderContext, budget: RecordBudget, standing: Standing) -> None:
        super().__init__(context, budget)
        self._standing = standing

    def count(self, iteration: Iteration) -> None:
        self._count(iteration, sum(len(unit.cache_records.program) for unit in iteration.traced.units))

    def next(self, iteration: Iteration, agenda: Agenda) -> Guidance:
        self.is_over = self._standing.is_over
        threshold = 0 if self.is_over else self.budget.threshold(iteration.next_range[1])
        rules = self._context.rules
        threshold = threshold_beside_cache(threshold, iteration.next_sample, rules.cache_measured_share, rules)
        return Guidance(self._context.settings, threshold)


class BehindCache(Recording):
    """Teaches the radiance cache until that is given up, and goes on as another recording then.

    Parameters
    ----------
    cached : CacheRecording
    behind : UnguidedRecording
    standing : Standing
        The cache's.
    """

    def __init__(
        self, context: RenderContext, cached: CacheRecording, behind: UnguidedRecording, standing: Standing
    ) -> None:
        super().__init__(context, cached.budget)
        self._now: Recording = cached
        self._behind, self._standing = behind, standing

    def count(self, iteration: Iteration) -> None:
        self._now.count(iteration)

    def next(self, iteration: Iteration, agenda: Agenda) -> Guidance:
        if self._standing.is_over and self._now is not self._behind:
            self._now = self._behind
            self._behind.budget.paths_per_sample = self.budget.paths_per_sample
            self.budget = self._behind.budget
        guidance = self._now.next(iteration, agenda)
        self.is_over = self._now.is_over
        return guidance


def threshold_beside_cache(threshold: int, next_sample: int, most: float, rules: Rules = RULES) -> int:
    """Paths that record where others end in the radiance cache: they go on, and cost what the cache would save.

    Parameters
    ----------
    threshold : int
        Paths whose hash is below would be recorded: 2**32 is all.
    next_sample : int
        Samples a pixel so far. The first cells are taught by all.
    most : float
        Of the paths, that may record later.
    rules : Rules
    """
    if next_sample < rules.cache_early_samples:
        return threshold
    return min(threshold, int(most * 2**32))


def learns_after(samples: int, *, lights_pay: bool, rules: Rules = RULES) -> bool:
    """Whether more is to be learned without guiding once so many samples a pixel have been rendered.

    Parameters
    ----------
    samples : int
    lights_pay : bool
        Whether lights are sampled by what was learned.
    rules : Rules
    """
    return samples < (rules.lights_samples if lights_pay else rules.learned_samples)


def unguided_budget(
    settings: RenderSettings, paths_per_sample: int, unit_pixels: int, *, learns_lights: bool, rules: Rules = RULES
) -> RecordBudget:
    """How many records iterations take that guide nothing; parameters are those of `RecordBudget`."""
    wanted = rules.unguided_records
    if learns_lights:
        wanted = min(int(rules.unguided_records_share * paths_per_sample * settings.samples) + 1, wanted)
    return RecordBudget(paths_per_sample, unit_pixels, wanted, rules)
