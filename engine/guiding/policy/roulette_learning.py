# SPDX-License-Identifier: GPL-3.0-or-later
"""What Russian roulette learns in the first iterations: which surfaces bring much for what they cost.

`RouletteLearner` alone is the learner of a render that guides nothing; otherwise `RouletteModel` is a part of
`Learner`. Without guiding a few samples a pixel teach enough: from then on nothing is recorded, and no thread waits.
"""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from engine.guiding.fields.reflected.field import NUMBER_LEAST, NUMBER_SCALE
from engine.guiding.fields.reflected.model import ReflectedModel
from engine.guiding.models.report import GuidingReport
from engine.guiding.policy.costs import IterationCosts
from engine.guiding.policy.guidance import Guidance
from engine.guiding.policy.iterations import RecordBudget
from engine.guiding.policy.trial import Part
from engine.guiding.records.of_unit import UnitRecords
from engine.guiding.records.vertices import VertexRecords, allocate_vertex_records, join_records
from engine.ris.orca import image_variance, pixel_weights, sample_variance
from engine.scene.description import Notice
from engine.settings import RenderSettings
from engine.state.film import FilmTile
from engine.state.unit import CURRENT, Unit, UnitCosts

#: Samples a pixel from which on nothing more is learned, and records that an iteration aims at until then.
_LEARNED_SAMPLES = 15
_RECORDS = 1 << 15
#: By how much longer paths live than the theory says, and the least probability of going on: estimates are uncertain,
#: and ending paths that mattered costs more than tracing some that do not.
_FACTOR = 2.0
_LEAST = 0.1
_REHEARSED_RECORDS = 16


class RouletteModel:
    """What roulette goes by in one render."""

    def __init__(self) -> None:
        self._cells = ReflectedModel()

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
        field = self._cells.field
        if field is None:
            return
        weight = np.maximum(sums.weight, 1e-20)[:, None]
        variance = image_variance(sample_variance(sums.radiance / weight, sums.square / weight), weights)
        vertex_count = costs.closest_count / max(costs.path_count, 1)
        field.numbers[NUMBER_SCALE] = _FACTOR * math.sqrt(vertex_count / max(variance, 1e-20))
        field.numbers[NUMBER_LEAST] = _LEAST

    def complete(self, guidance: Guidance, weights: np.ndarray | None) -> Guidance:
        """Guidance whose paths end by what is known."""
        guidance = guidance.with_roulette(self._cells.field, weights)
        if guidance.challenger is None:
            return guidance
        return replace(guidance, challenger=guidance.challenger.with_roulette(self._cells.field, weights))

    def rehearse(self) -> None:
        """Load (or compile) the kernels of learning by learning from nothing in particular."""
        ReflectedModel().learn(allocate_vertex_records(_REHEARSED_RECORDS), _REHEARSED_RECORDS)


class RouletteLearner:
    """Owns what roulette learns in a render that guides nothing.

    Parameters
    ----------
    settings : RenderSettings
    paths_per_sample : int
        Pixels of the image.
    unit_pixels : int
        Of the largest unit of work.
    """

    #: Nothing outlives the render.
    wants_last = False
    known_samples = 0.0

    def __init__(self, settings: RenderSettings, paths_per_sample: int, unit_pixels: int) -> None:
        self.settings = settings
        self.notices: list[Notice] = []
        self.report = GuidingReport(method="OFF")
        self.parts = [Part(0, 1, CURRENT)]
        self.is_over = False
        self._model = RouletteModel()
        self._budget = RecordBudget(paths_per_sample, unit_pixels, _RECORDS)

    def narrow(self, pixel_count: int, _expected_paths: float) -> None:
        """Take how many pixels the next iteration has."""
        self._budget.paths_per_sample = pixel_count

    def rehearse(self) -> Guidance:
        """Load (or compile) the kernels of learning."""
        self._model.rehearse()
        return Guidance(self.settings, 0)

    def first(self) -> Guidance:
        """Guidance of the first iteration: none, but record."""
        return self._model.complete(Guidance(self.settings, self._budget.threshold(1)), None)

    def learn(
        self, units: Sequence[UnitRecords], recorded_share: float, sums: FilmTile, size: tuple[int, int],
        costs: IterationCosts, next_range: tuple[int, int], *, is_whole: bool = True,
    ) -> Guidance:
        """Learn from an iteration, and say how to go on; see `Learner.learn`."""
        started = time.perf_counter()
        records, row_count = join_records([unit.vertices for unit in units])
        self.report.record_count += row_count
        if row_count:
            self._budget.count(row_count + costs.dropped_records, recorded_share * costs.path_count)
        mean = sums.radiance / np.maximum(sums.weight, 1e-20)[:, None]
        weights = pixel_weights(mean.reshape(*size, -1))
        self._model.learn(records, row_count, sums, weights, costs)
        self.report.field_seconds += time.perf_counter() - started
        self.parts = [Part(*next_range, CURRENT)]
        self.is_over = next_range[0] >= _LEARNED_SAMPLES
        threshold = 0 if self.is_over else self._budget.threshold(next_range[1])
        return self._model.complete(Guidance(self.settings, threshold), weights)

    def keep(self, units: Sequence[UnitRecords]) -> None:
        """There is nobody else who learns."""

    def compare(self, unit: Unit, film: FilmTile, costs: UnitCosts) -> None:
        """There is nothing to compare."""

    def close(self) -> None:
        """There is nothing to end."""
