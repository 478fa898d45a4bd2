# SPDX-License-Identifier: GPL-3.0-or-later
"""Is guiding worth it? It is compared with unguided rendering, at first, and again later on unless there is no doubt.

Where it loses, less is guided if that may pay, else nothing (docs/decisions/trial-and-choice.md). A network that
directions are drawn from has a trial of its own when it begins to guide; where it loses, what stood in for it goes on.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from engine.guiding.policy import trial
from engine.guiding.policy.cautious import CautiousTrial
from engine.guiding.policy.context import RenderContext
from engine.guiding.policy.iteration import Iteration
from engine.guiding.policy.learnables.regions import LearnedRegions
from engine.guiding.policy.learnables.source import LearnedSource
from engine.guiding.policy.plain_trial import PlainTrial
from engine.guiding.policy.questions.media import MediaQuestion
from engine.guiding.policy.questions.method import MethodQuestion
from engine.guiding.policy.questions.question import Question
from engine.guiding.policy.rules import Rules
from engine.guiding.policy.standing import Standing
from engine.guiding.policy.trial import ArmSamples
from engine.guiding.policy.way import MEDIA, SURFACES, Way
from engine.guiding.saved.learned import LOST
from engine.state.film import FilmTile
from engine.state.unit import PLAIN, Unit


def learning_overhead(iteration: Iteration, rules: Rules) -> float:
    """What learning will cost, as a share of what guiding all pixels will.

    The iterations compared are short. Those to come are longer, and learn from as many records.

    Parameters
    ----------
    iteration : Iteration, that has compared
    rules : Rules
    """
    to_come = min(rules.longest_iteration, iteration.samples_left)
    return iteration.learning_seconds / max(iteration.seconds * max(to_come / iteration.sample_count, 1.0), 1e-9)


class GuidingQuestion(Question):
    """Whether anything is guided.

    Parameters
    ----------
    context : RenderContext
    standing : Standing
        Guiding's: this says when it is given up.
    regions : LearnedRegions
    source : LearnedSource or None
        What directions are drawn from, if not the mixture field.
    method : MethodQuestion
    media : MediaQuestion
    cautious : CautiousTrial or None
        Where guiding is tried cautiously.
    uses_clock : bool
        Whether the image may depend on the clock.
    trial_share : float
        Share of the pixels that guiding is tried on until it has been found to pay.

    Attributes
    ----------
    trial : PlainTrial
    """

    def __init__(
        self, context: RenderContext, standing: Standing, regions: LearnedRegions, source: LearnedSource | None,
        method: MethodQuestion, media: MediaQuestion, cautious: CautiousTrial | None, *, uses_clock: bool,
        trial_share: float,
    ) -> None:
        self._context, self._standing, self._regions, self._source = context, standing, regions, source
        self._method, self._media, self._cautious = method, media, cautious
        self._uses_clock, self._trial_share = uses_clock, trial_share
        self._is_guiding = regions.models is not None and not (source is not None and source.is_missed)
        self.trial = PlainTrial(
            context.pixel_count, tries_plain=context.settings.guiding_trial, rules=context.rules
        )
        self.other_arms: Sequence[ArmSamples] = ()
        #: The trial of what stood in for the source that guides, and the sample until which that gets the benefit of
        #: the doubt.
        self._stand_in: PlainTrial | None = None
        self._doubtful_until = 0.0

    @property
    def is_over(self) -> bool:
        return self._standing.is_over

    @property
    def is_settled(self) -> bool:
        return self.trial.is_settled

    @property
    def verdict(self) -> str:
        """What comparing has said so far, one of `engine.guiding.saved.VERDICTS`."""
        return LOST if self._standing.is_over else self.trial.verdict

    @property
    def pixel_share(self) -> float:
        return self._trial_share if self.other_arms else 1.0

    @property
    def is_doubtful(self) -> bool:
        """Whether neither guiding nor what stood in for the source has been found to pay: then few paths are recorded.
        """
        is_tried = self._context.settings.guiding_trial and not (self._source is not None and self._source.stands_alone)
        is_promising = self._cautious is not None and self._cautious.is_promising
        has_paid = self._stand_in is not None and self._stand_in.is_paying
        return is_tried and not (self.trial.is_paying or has_paid or is_promising)

    def narrow(self, pixel_count: int, expected_samples: float) -> None:
        if pixel_count < self._context.pixel_count:
            # Units are divided by which pixels go on.
            self._trial_share = 1.0

    def way(self, way: Way) -> Way:
        return replace(way, is_guided=self._is_guiding)

    def observe(self, unit: Unit, film: FilmTile, cost: float, *, is_aside: bool) -> None:
        self.trial.compare(unit, film, cost, is_aside=is_aside)

    def conclude(self, iteration: Iteration) -> None:
        overhead = 0.0
        if self._uses_clock:
            overhead = learning_overhead(iteration, self._context.rules)
        next_sample, weights = iteration.next_sample, iteration.image.weights
        assert weights is not None
        says = self.trial.judge(
            weights, next_sample, overhead, iteration.samples_left, is_part=bool(self.other_arms),
            is_cautious=self._cautious is not None, is_learning=self._is_learning(next_sample),
        )
        report = self._context.report
        if says:
            report.trials.append(f"{self._tried} over OFF {self.trial.efficiency:.2f} at sample {next_sample}")
        self.other_arms = ()
        if self.trial.has_lost:
            self._lose(iteration)
        report.efficiency = self.trial.efficiency

    def _is_learning(self, next_sample: int) -> bool:
        """Whether the source guides and has hardly learned yet."""
        return self._source is not None and self._source.is_learning and next_sample < self._doubtful_until

    @property
    def _tried(self) -> str:
        """What is compared, for people."""
        is_stand_in = self._source is not None and not (self._source.has_stand_in or self._source.stands_alone)
        return "the mixture field" if is_stand_in else self._method.trial.rung

    def _lose(self, iteration: Iteration) -> None:
        """Guide by what stands in for the source; or less, where that may pay; else give guiding up."""
        if self._source is not None and self._source.has_stand_in:
            self._source.give_up(iteration.next_sample)
            if self._stand_in is None:
                # It has long been learning: no more benefit of the doubt.
                self.trial.restart(trial.LAST_DOUBT)
            else:
                # Its trial goes on where it stood.
                self.trial, self._stand_in = self._stand_in, None
            return
        is_short = trial.is_short(iteration.next_sample, iteration.samples_left, self._context.rules)
        if not is_short and self._media.fall_back():
            self.trial.restart(trial.LAST_DOUBT)
            return
        self._standing.is_over = True
        self._context.report.stopped_at = iteration.next_sample
        self._context.report.chosen = "OFF"

    def _weigh_promises(self, iteration: Iteration) -> None:
        """Give up where a comparison shows guiding to lose and regions promise nothing of what would be guided now."""
        cautious = self._cautious
        if cautious is None or self._regions.models is None:
            return
        while not self.is_over and self.is_doubtful and cautious.is_hopeless(self._promised, self.trial.efficiency):
            self._lose(iteration)
        cautious.weigh(self._promised, self.trial.efficiency)

    @property
    def _promised(self) -> tuple[float, ...]:
        """What regions promise of guiding what would be guided now, by kind of vertex."""
        surfaces, media = self._regions.promises
        return {SURFACES: (surfaces,), MEDIA: (media,)}.get(self._media.trial.guided, (surfaces, media))

    def plan(self, iteration: Iteration, *, is_free: bool) -> Sequence[ArmSamples]:
        if self._source is not None and self._source.has_taken_over():
            # What was tried so far was the mixture field.
            self._stand_in, self.trial = self.trial, self.trial.successor(iteration.next_sample)
            left = self._context.rules.source_doubtful_share * iteration.samples_left
            self._doubtful_until = iteration.next_sample + left
        self._weigh_promises(iteration)
        if self.is_over:
            return ()
        knows_something = self._is_guiding = self._regions.models is not None
        arms = self.trial.plan(
            *iteration.next_range, knows_something=knows_something, is_whole=iteration.traced.is_whole,
            is_last=self._standing.is_narrow or iteration.is_next_last, is_free=is_free,
        )
        self.other_arms = ()
        if knows_something and self._trial_share < 1.0 and self.is_doubtful and not self.is_settled:
            self.other_arms = [ArmSamples(*iteration.next_range, PLAIN)]
        return arms

    def rehearse(self, channel_count: int) -> None:
        trial.rehearse(channel_count)
