# SPDX-License-Identifier: GPL-3.0-or-later
"""What Russian roulette learns in the first iterations: which surfaces bring much for what they cost.

`RouletteModel` is a part of the learner of a render, guided (`Learner`) or not (`UnguidedLearner`).
"""

from __future__ import annotations

import math

import numpy as np

from engine.guiding.fields.reflected.field import NUMBER_LEAST, NUMBER_SCALE, ReflectedField
from engine.guiding.fields.reflected.model import ReflectedModel
from engine.guiding.policy.costs import IterationCosts
from engine.guiding.policy.guidance import Guidance
from engine.guiding.policy.rules import RULES, Rules
from engine.guiding.policy.trial import GuidingTrial, Part
from engine.guiding.records.vertices import VertexRecords, allocate_vertex_records
from engine.ris.orca import image_variance, sample_variance
from engine.state.film import FilmTile
from engine.state.unit import CHALLENGER, CURRENT, Unit

_REHEARSED_RECORDS = 16


class RouletteModel:
    """What roulette goes by in one render.

    Parameters
    ----------
    rules : Rules
    """

    def __init__(self, rules: Rules = RULES) -> None:
        self._rules = rules
        self._cells = ReflectedModel()
        #: One sample a pixel has no variance: beside that no path would be worth its cost, or any.
        self._knows_variance = False

    @property
    def field(self) -> ReflectedField | None:
        """What is known of surfaces."""
        return self._cells.field

    def learn(
        self, records: VertexRecords, row_count: int, sums: FilmTile, weights: np.ndarray, costs: IterationCosts
    ) -> None:
        """Take an iteration's records.

        Parameters
        ----------
        sums : FilmTile, the image so far
        weights : float32 (P,), of its pixels (`engine.ris.orca.pixel_weights`)
        costs : IterationCosts
        """
        self._cells.learn(records, row_count)
        field = self.field
        if field is None:
            return
        weight = np.maximum(sums.weight, 1e-20)[:, None]
        # The mean is taken from the same samples.
        left = 1.0 - sums.weight_squared / weight[:, 0] ** 2
        by_pixel = sample_variance(sums.radiance / weight, sums.square / weight)
        variance = image_variance(by_pixel / np.where(left > self._rules.roulette_least_left, left, np.nan), weights)
        self._knows_variance = variance > 0.0
        vertex_count = costs.closest_count / max(costs.path_count, 1)
        field.numbers[NUMBER_SCALE] = self._rules.roulette_factor * math.sqrt(vertex_count / max(variance, 1e-20))
        field.numbers[NUMBER_LEAST] = self._rules.roulette_least

    def complete(self, guidance: Guidance, weights: np.ndarray | None) -> Guidance:
        """Guidance whose paths end by what is known."""
        if self.field is None or not self._knows_variance:
            return guidance
        return guidance.with_roulette(self.field, weights)

    def rehearse(self) -> None:
        """Load (or compile) the kernels of learning by learning from nothing in particular."""
        ReflectedModel().learn(allocate_vertex_records(_REHEARSED_RECORDS), _REHEARSED_RECORDS)


def _add_unit(
    moments: GuidingTrial, unit: Unit, film: FilmTile, cost: float, *, is_challenger: bool, uses_clock: bool,
    rules: Rules,
) -> None:
    """Take a unit whose paths ended by the throughput, or (the challenger) by what was learned."""
    moments.add(unit.film_index, film.radiance, film.square, unit.sample_count, is_challenger)
    if is_challenger and not uses_clock:
        cost *= rules.roulette_counted_overhead
    moments.add_cost(cost, len(unit.pixels) * unit.sample_count, is_challenger)


class RouletteElsewhere:
    """Samples of pixels that were not guided while guiding was tried on others: by the throughput before anything was
    known of surfaces, then by what was learned.

    Parameters
    ----------
    pixel_count : int
    uses_clock : bool
        Whether units cost seconds; else rays.
    rules : Rules

    Attributes
    ----------
    moments : GuidingTrial
    """

    def __init__(self, pixel_count: int, *, uses_clock: bool, rules: Rules = RULES) -> None:
        self._rules = rules
        self.moments = GuidingTrial(pixel_count, rules=rules)
        self._uses_clock = uses_clock
        #: Samples a pixel by either.
        self._samples = [0, 0]
        self._newest = -1

    def add(self, unit: Unit, film: FilmTile, cost: float, *, is_learned: bool) -> None:
        """Take a finished unit's sums and its cost; no two threads at once."""
        _add_unit(
            self.moments, unit, film, cost, is_challenger=is_learned, uses_clock=self._uses_clock, rules=self._rules
        )
        if unit.sample_first > self._newest:
            self._newest = unit.sample_first
            self._samples[int(is_learned)] += unit.sample_count

    @property
    def is_known(self) -> bool:
        """Whether there are enough samples of both to tell anything."""
        return min(self._samples) > 1


class RouletteTrial:
    """Half of the first iteration without guiding goes by what roulette has learned, half by the throughput alone.

    Where guiding was tried on a part of the pixels, the others have had samples by both: nothing need be rendered.

    Parameters
    ----------
    pixel_count : int
    samples : (int, int)
        First sample and samples a pixel of the iteration.
    uses_clock : bool
        Whether units cost seconds; else rays.
    elsewhere : RouletteElsewhere, optional
        What pixels have had that were not guided.
    rules : Rules

    Attributes
    ----------
    parts : list of Part, of the iteration
    is_running : bool, it is being compared
    is_known : bool, there is something to judge, though no iteration has compared
    is_won : bool, roulette goes by what was learned
    """

    def __init__(
        self, pixel_count: int, samples: tuple[int, int], *, uses_clock: bool,
        elsewhere: RouletteElsewhere | None = None, rules: Rules = RULES,
    ) -> None:
        self._rules = rules
        first, count = samples
        half = count // 2
        self.parts = [Part(first, count - half, CURRENT), Part(first + count - half, half, CHALLENGER)]
        # Of fewer nothing can be told.
        self.is_running = half > 1
        self.is_won = True
        #: Whether there is a comparison to judge.
        self.is_known = elsewhere is not None and elsewhere.is_known
        self._moments = GuidingTrial(pixel_count, rules=rules)
        if elsewhere is not None and elsewhere.is_known:
            self.is_running = False
            self._moments = elsewhere.moments
        self._uses_clock = uses_clock

    def compare(self, unit: Unit, film: FilmTile, cost: float) -> None:
        """Take a finished unit's sums and its cost; no two threads at once."""
        _add_unit(
            self._moments, unit, film, cost, is_challenger=unit.arm == CHALLENGER, uses_clock=self._uses_clock,
            rules=self._rules,
        )

    def judge(self, weights: np.ndarray, next_sample: int) -> str:
        """Draw the conclusion, by the weights of the pixels' variances; returns it in words."""
        efficiency = self._moments.efficiency(weights)
        self.is_running = self.is_known = False
        # Written so that NaN, nothing compared, loses.
        self.is_won = efficiency >= self._rules.roulette_least_efficiency
        return f"learned roulette over OFF {efficiency:.2f} at sample {next_sample}"
