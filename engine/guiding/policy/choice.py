# SPDX-License-Identifier: GPL-3.0-or-later
"""Which method the next iteration goes by: what is in use, compared with unguided rendering, then with finer methods.

Some iterations render a part of their samples by another method, and efficiencies, 1 / (variance x cost), are compared
(`engine.guiding.policy.trial`); with unguided rendering again later on, unless there is no doubt. All methods have the
same expected image, and what is chosen depends on samples already taken only. With the method AUTO a finer method is
tried where resampling promises to pay (`engine.guiding.policy.learning`), taken up if it does, and left again if it no
longer does.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from engine.guiding.policy import trial
from engine.guiding.policy.rules import RULES, Rules
from engine.guiding.policy.trial import GuidingTrial, Part, SampleMoments
from engine.guiding.saved.learned import LOST, OPEN, WON
from engine.state.film import FilmTile
from engine.state.unit import CHALLENGER, CURRENT, PLAIN, Unit


class Choice:
    """What a render goes by.

    Parameters
    ----------
    pixel_count : int
    rung : str
        Method to begin with.
    tries_plain : bool
        Compare with unguided rendering.
    rules : Rules

    Attributes
    ----------
    parts : list of Part, of the iteration in work
    challenger : str, method of the arm CHALLENGER, empty if there is none
    has_lost : bool, the last iteration showed unguided rendering to be better
    efficiency : float, over unguided rendering when last compared
    trials : list of str, what was compared, for people
    is_narrow : bool, few pixels are left: methods are compared no more, for what these say is luck
    """

    def __init__(self, pixel_count: int, rung: str, *, tries_plain: bool, rules: Rules = RULES) -> None:
        self._rules = rules
        self.rung = rung
        self.challenger = ""
        self.parts = [Part(0, 1, CURRENT)]
        self.has_lost = False
        self.efficiency = math.nan
        self.trials: list[str] = []
        self.is_narrow = False
        self._pixel_count = pixel_count
        self._tries_plain = tries_plain
        #: Where the trial against unguided rendering stands.
        self._iteration = 0
        self._compared_at = 0
        self._has_won = False
        #: Whether the newest comparison was of a part of the pixels.
        self._was_part = False
        self._least_paying = self._rules.least_of_short
        self._trial: GuidingTrial | None = None
        #: All unguided samples of the image, and whether those of the iteration in work are, whatever their arm.
        self._plain = SampleMoments(pixel_count)
        self._knows_something = False
        #: Later comparisons with unguided rendering: whether this iteration takes part in one, from which sample on the
        #: next is due, and the overheads of its iterations so far.
        self._looks_again = False
        self._look_from = 0
        self._overheads: list[float] = []
        #: Log efficiencies of the challenger so far, and from which sample on methods may be tried again.
        self._evidence: list[float] = []
        self._not_before: dict[str, int] = {}

    @property
    def is_settled(self) -> bool:
        """Whether guiding has been found better than unguided rendering, or nobody asks."""
        return not self._tries_plain or self._has_won or self._iteration > max(self._rules.least_efficiency)

    @property
    def is_paying(self) -> bool:
        """Whether the newest comparison has shown guiding to pay, by as much as such a one has to."""
        return self.efficiency >= self._least_paying

    @property
    def guided_share(self) -> float:
        """Share of the samples of the iteration in work that are guided."""
        counts = [(count, arm != PLAIN) for _, count, arm in self.parts]
        return sum(count for count, is_guided in counts if is_guided) / sum(count for count, _ in counts)

    def has_tried(self, method: str) -> bool:
        """Whether a method is in use, or has been compared."""
        return method == self.rung or method in self._not_before

    def has_use_for(self, method: str, next_sample: int) -> bool:
        """Whether a method is in use or being tried, or could be tried now."""
        return method in (self.rung, self.challenger) or next_sample >= self._not_before.get(method, 0)

    def restart(self, iteration: int) -> None:
        """Compare with unguided rendering again, from a stage of the trial on: something else guides now."""
        self._iteration = iteration
        self._has_won = False
        self._trial = None
        self._overheads = []

    @property
    def verdict(self) -> str:
        """What comparing guiding with unguided rendering has said so far, one of `engine.guiding.saved.VERDICTS`."""
        if self.has_lost:
            return LOST
        return WON if self._tries_plain and self.is_settled else OPEN

    def resume(self, verdict: str, efficiency: float) -> None:
        """Begin with something to guide by, and with what another render has found out about it.

        It is never trusted blindly, for another view may be another matter: what won is looked at again later on.
        """
        if self._tries_plain and verdict == WON:
            self._has_won, self.efficiency, self._look_from = True, efficiency or math.nan, self._rules.look_again_from

    def compare(self, unit: Unit, film: FilmTile, cost: float) -> None:
        """Take a finished unit's sums and its cost, in any unit; no two threads at once."""
        sums = unit.film_index, film.radiance, film.square, unit.sample_count
        if self.is_aside(unit):
            self._plain.add(*sums)
        elif len(self.parts) > 1 and self._trial is not None:
            is_challenger = self._is_challenger(unit.arm)
            self._trial.add(*sums, is_challenger)
            self._trial.add_cost(cost, len(unit.pixels) * unit.sample_count, is_challenger)
        elif self._tries_plain and not self._knows_something:
            self._plain.add(*sums)

    def is_aside(self, unit: Unit) -> bool:
        """Whether none of a unit's pixels is guided in the iteration in work: parts of those that are begin guided."""
        return unit.arm == PLAIN and unit.sample_first == self.parts[0].first_sample

    def _is_challenger(self, arm: int) -> bool:
        return arm == CHALLENGER if self.challenger else arm == CURRENT

    def judge(
        self, weights: np.ndarray, next_sample: int, overhead: float, samples_left: float = math.inf, *,
        is_part: bool = False, is_cautious: bool = False,
    ) -> None:
        """After an iteration: draw the conclusion, if it compared.

        Parameters
        ----------
        weights : float32 (P,), of the pixels' variances
        next_sample : int
        overhead : float
            Cost of what the arm compared needs besides tracing, as a share of that.
        samples_left : float
            Samples a pixel to come, as far as it is known.
        is_part : bool
            Whether a part of the pixels was compared.
        is_cautious : bool
            As of `engine.guiding.policy.trial.least_efficiency`.
        """
        self._iteration += 1
        self.has_lost = False
        compared, self._trial = self._trial, None
        if compared is None:
            return
        if self._looks_again:
            self._overheads.append(overhead)
            if len(self._overheads) < self._rules.looks:
                self._trial = compared
                return
            overhead = sum(self._overheads) / self._rules.looks
            self._overheads = []
        efficiency = compared.efficiency(weights) / (1.0 + overhead)
        if self.challenger:
            self._judge_challenger(efficiency, next_sample)
            return
        if self._looks_again:
            self._look(efficiency, next_sample)
            return
        if self.efficiency >= self._rules.least_of_short and not self._was_part:
            # It has paid once: what there is to lose is small, however little is left. A part can be lucky.
            samples_left = math.inf
        self.efficiency = efficiency
        self.trials.append(f"{self.rung} over OFF {efficiency:.2f} at sample {next_sample}")
        self._has_won = efficiency >= self._rules.clear_efficiency[self._compared_at]
        least = trial.least_efficiency(
            self._compared_at, next_sample, samples_left, is_part=is_part, is_cautious=is_cautious,
            rules=self._rules,
        )
        # Written so that NaN, nothing compared, goes on.
        self.has_lost = efficiency < least
        self._was_part = is_part
        is_first_part = is_part and self._compared_at == min(self._rules.least_efficiency)
        self._least_paying = self._rules.sure_of_first_part if is_first_part else self._rules.least_of_short
        if self.is_settled:
            self._look_from = self._rules.again * next_sample

    def _look(self, efficiency: float, next_sample: int) -> None:
        """Take a later comparison with unguided rendering."""
        if math.isnan(efficiency):
            return
        self.efficiency = efficiency
        self.trials.append(f"{self.rung} over OFF {efficiency:.2f} at sample {next_sample}")
        self.has_lost = efficiency < self._rules.least_later
        self._look_from = self._rules.again * next_sample

    def _judge_challenger(self, efficiency: float, next_sample: int) -> None:
        if math.isnan(efficiency):
            return
        self._evidence.append(math.log(efficiency) if efficiency > 0.0 else -math.inf)
        mean = math.exp(sum(self._evidence) / len(self._evidence))
        stage = min(len(self._evidence), len(self._rules.taken)) - 1
        is_taken = mean >= self._rules.taken[stage]
        if not is_taken and mean > self._rules.dropped[stage]:
            return
        self.trials.append(f"{self.challenger} over {self.rung} {mean:.2f} at sample {next_sample}")
        self._not_before[self.rung if is_taken else self.challenger] = self._rules.again * next_sample
        if is_taken:
            self.rung = self.challenger
        self.challenger = ""

    def skip(self, first: int, count: int) -> None:
        """After an iteration that nothing is learned from: the next, of so many samples from `first` on, is alike."""
        self._iteration += 1
        self.plan(first, count, (), knows_something=False)

    def plan(
        self, first: int, count: int, offers: Sequence[str], *, knows_something: bool = True, is_whole: bool = True,
        is_last: bool = False,
    ) -> None:
        """Divide the next iteration.

        Parameters
        ----------
        first, count : int
            Its samples.
        offers : sequence of str
            Methods that could be tried, in the order in which to; one that is being tried must stay among them.
        knows_something : bool
            Whether there is anything to guide by.
        is_whole : bool
            Whether its samples lie in all of u: within a stratum they vary less than the unguided ones of all strata,
            and those of the iteration alone are compared.
        is_last : bool
            Whether nobody will go by what the iteration finds.
        """
        self._knows_something = knows_something
        if self.is_narrow or is_last:
            self._end_comparison(first, count)
            return
        is_tried = self._tries_plain and not self._has_won and knows_something
        self.parts = trial.parts(self._iteration, first, count, is_tried=is_tried, rules=self._rules)
        self._looks_again = False
        if len(self.parts) > 1:
            self._compared_at = self._iteration
        elif self.is_settled and count >= self._rules.least_compared:
            self._looks_again = self._is_due(first)
            if self._looks_again:
                self.parts = trial.compared_parts(first, count)
            else:
                self._challenge(first, count, offers)
        if len(self.parts) > 1 and self._trial is None:
            # A finer method's rival is guided too, and changes.
            has_same_samples = is_whole and not self.challenger
            self._trial = GuidingTrial(self._pixel_count, self._plain if has_same_samples else None, self._rules)

    def _end_comparison(self, first: int, count: int) -> None:
        """Go on with what is in use, whatever was being compared."""
        self.parts = [Part(first, count, CURRENT)]
        self._looks_again = False
        self.challenger, self._trial, self._overheads = "", None, []

    def _is_due(self, first: int) -> bool:
        """Whether to compare with unguided rendering again."""
        # Written so that NaN, nothing compared, is not due.
        is_doubtful = self.efficiency < self._rules.sure
        return self._tries_plain and not self.challenger and first >= self._look_from and is_doubtful

    def _challenge(self, first: int, count: int, offers: Sequence[str]) -> None:
        if self.challenger not in offers:
            self.challenger = ""
        if not self.challenger:
            due = [rung for rung in offers if rung != self.rung and self.has_use_for(rung, first)]
            if not due:
                return
            self.challenger = due[0]
            self._evidence = []
        half = count // 2
        self.parts = [Part(first, count - half, CURRENT), Part(first + count - half, half, CHALLENGER)]
