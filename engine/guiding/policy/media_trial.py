# SPDX-License-Identifier: GPL-3.0-or-later
"""Does guiding pay on surfaces, and does it within media? In scenes that have both the one may pay and the other not.

The first comparison is of both together with unguided rendering (`engine.guiding.policy.choice`). Where they win, each
is left out in turn, by half of an iteration's samples, and stays out by the rule by which a finer method is taken.
Where they lose and much of the render is left, media alone are guided, then surfaces alone, before guiding is given up.
"""

from __future__ import annotations

import math

import numpy as np

from engine.guiding.policy.rules import RULES, Rules
from engine.guiding.policy.trial import GuidingTrial, Part
from engine.state.film import FilmTile
from engine.state.unit import CHALLENGER, CURRENT, Unit

#: What is guided, in words for people.
BOTH, SURFACES, MEDIA = "surfaces and media", "surfaces alone", "media alone"


class MediaTrial:
    """What is guided of surfaces and media, and the comparisons that say so.

    Parameters
    ----------
    pixel_count : int
    rules : Rules

    Attributes
    ----------
    guided : str, one of BOTH, SURFACES and MEDIA: what the arm CURRENT guides
    challenger : str, what the arm CHALLENGER guides, '' if nothing is compared
    parts : list of Part, of the iteration while something is
    """

    def __init__(self, pixel_count: int, rules: Rules = RULES) -> None:
        self._rules = rules
        self.guided = BOTH
        self.challenger = ""
        self.parts: list[Part] = []
        self._pixel_count = pixel_count
        self._trial: GuidingTrial | None = None
        self._evidence: list[float] = []
        #: What is left to be tried instead of both, and from which sample on.
        self._due = [SURFACES, MEDIA]
        self._not_before = 0
        self._is_comparing = False

    @property
    def is_running(self) -> bool:
        """Whether the iteration in work compares."""
        return self._is_comparing

    def plan(self, first: int, count: int, *, is_free: bool) -> None:
        """Divide the next iteration, if it is free to be divided."""
        self._is_comparing = False
        if not is_free or self.guided != BOTH or count < self._rules.least_compared:
            return
        if not self.challenger:
            if first < self._not_before:
                return
            self.challenger = self._due[0]
            self._evidence = []
        half = count // 2
        self.parts = [Part(first, count - half, CURRENT), Part(first + count - half, half, CHALLENGER)]
        self._trial = GuidingTrial(self._pixel_count, rules=self._rules)
        self._is_comparing = True

    def compare(self, unit: Unit, film: FilmTile, cost: float) -> None:
        """Take a finished unit's sums and its cost; no two threads at once."""
        assert self._trial is not None
        is_challenger = unit.arm == CHALLENGER
        self._trial.add(unit.film_index, film.radiance, film.square, unit.sample_count, is_challenger)
        self._trial.add_cost(cost, len(unit.pixels) * unit.sample_count, is_challenger)

    def judge(self, weights: np.ndarray, next_sample: int) -> str:
        """After an iteration: draw the conclusion, if it compared.

        Returns
        -------
        str
            It in words, '' if there is none yet.
        """
        if not self._is_comparing or self._trial is None:
            return ""
        efficiency = self._trial.efficiency(weights)
        self._is_comparing, self._trial = False, None
        if math.isnan(efficiency):
            return ""
        self._evidence.append(math.log(efficiency) if efficiency > 0.0 else -math.inf)
        mean = math.exp(sum(self._evidence) / len(self._evidence))
        stage = min(len(self._evidence), len(self._rules.taken)) - 1
        is_taken = mean >= self._rules.taken[stage]
        if not is_taken and mean > self._rules.dropped[stage]:
            return ""
        said = f"guiding {self.challenger} over {BOTH} {mean:.2f} at sample {next_sample}"
        if is_taken:
            self.guided = self.challenger
        else:
            self._due.append(self._due.pop(0))
            if self._due[0] == SURFACES:
                self._not_before = self._rules.again * next_sample
        self.challenger = ""
        return said

    def fall_back(self) -> bool:
        """Guide less, where all that was guided has lost against unguided rendering; False: nothing is left to try."""
        self.challenger = ""
        self._is_comparing, self._trial = False, None
        self.guided = {BOTH: MEDIA, MEDIA: SURFACES}.get(self.guided, "")
        return self.guided != ""
