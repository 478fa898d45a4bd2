# SPDX-License-Identifier: GPL-3.0-or-later
"""What Russian roulette learns in the first iterations: which surfaces bring much for what they cost."""

from __future__ import annotations

import math
import time

import numpy as np

from engine.guiding.fields.roulette.field import NUMBER_LEAST, NUMBER_SCALE, RouletteField
from engine.guiding.fields.roulette.model import RouletteFieldModel
from engine.guiding.policy.context import RenderContext
from engine.guiding.policy.costs import IterationCosts
from engine.guiding.policy.guidance import Guidance
from engine.guiding.policy.iteration import Iteration
from engine.guiding.policy.learnables.learnable import Learnable, Rehearsal
from engine.guiding.policy.rules import RULES, Rules
from engine.guiding.policy.standing import Standing
from engine.guiding.policy.way import ImageState, Way
from engine.guiding.records.vertices import VertexRecords, allocate_vertex_records
from engine.ris.orca import image_variance, sample_variance
from engine.state.film import FilmTile

_REHEARSED_RECORDS = 16


class LearnedRoulette(Learnable):
    """What roulette goes by in one render.

    Parameters
    ----------
    context : RenderContext
    until : float
        Samples a pixel from which on nothing more is learned.
    cache : Standing, optional
        That of the radiance cache: as long as it lasts, the first samples alone are learned from.
    """

    serves_guiding = False

    def __init__(self, context: RenderContext, until: float = math.inf, cache: Standing | None = None) -> None:
        self._report = context.report
        self._until, self._cache, self._early_samples = until, cache, context.rules.learned_samples
        self._model = RouletteModel(context.rules)

    @property
    def is_ready(self) -> bool:
        """Whether paths can end by what is known."""
        return self._model.is_ready

    def learn(self, iteration: Iteration) -> None:
        weights = iteration.image.weights
        lasts = self._cache is not None and not self._cache.is_over
        until = min(self._until, self._early_samples) if lasts else self._until
        if not iteration.row_count or iteration.next_sample > until or weights is None:
            return
        started = time.perf_counter()
        self._model.learn(iteration.records, iteration.row_count, iteration.sums, weights, iteration.costs)
        self._report.field_seconds += time.perf_counter() - started

    def complete(self, guidance: Guidance, way: Way, image: ImageState) -> Guidance:
        field = self._model.field
        if field is None or not (way.ends_by_learned and self.is_ready):
            return guidance
        return guidance.with_roulette(field, image.weights)

    def rehearse(self, rehearsal: Rehearsal) -> None:
        RouletteFieldModel().learn(allocate_vertex_records(_REHEARSED_RECORDS), _REHEARSED_RECORDS)


class RouletteModel:
    """What roulette goes by in one render.

    Parameters
    ----------
    rules : Rules
    """

    def __init__(self, rules: Rules = RULES) -> None:
        self._rules = rules
        self._cells = RouletteFieldModel()
        #: One sample a pixel has no variance: beside that no path would be worth its cost, or any.
        self._knows_variance = False

    @property
    def field(self) -> RouletteField | None:
        """What is known of surfaces."""
        return self._cells.field

    @property
    def is_ready(self) -> bool:
        """Whether paths can end by it."""
        return self.field is not None and self._knows_variance

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
