# SPDX-License-Identifier: GPL-3.0-or-later
"""What the radiance cache learns between iterations, and how many paths measure what it lacks.

`CacheLearner` alone is the learner of a render that guides nothing; in a guided one it is a part of `Learner`.
"""

from __future__ import annotations

import time
from collections.abc import Sequence

from engine.guiding.fields.cells.model import CellModel
from engine.guiding.models.report import GuidingReport
from engine.guiding.policy.costs import IterationCosts
from engine.guiding.policy.guidance import Guidance
from engine.guiding.policy.iterations import RecordBudget
from engine.guiding.policy.trial import Part
from engine.guiding.records.vertices import VertexRecords, allocate_vertex_records, join_records
from engine.scene.description import Notice
from engine.settings import RenderSettings
from engine.state.film import FilmTile
from engine.state.unit import CURRENT, Unit, UnitCosts

#: Least share of the paths that go on where they could end, and measure what the cache lacks.
MEASURED_SHARE = 0.125
#: Samples a pixel before which more of them may: nothing is known yet, and the records teach all the sooner.
EARLY_SAMPLES = 7
_REHEARSED_RECORDS = 16


class CacheLearner:
    """Owns the cells of one render.

    Parameters
    ----------
    settings : RenderSettings
        With a radiance cache.
    paths_per_sample : int
        Pixels of the image.
    unit_pixels : int
        Of the largest unit of work.
    """

    sink = None
    is_over = False

    def __init__(self, settings: RenderSettings, paths_per_sample: int, unit_pixels: int) -> None:
        self.settings = settings
        self.notices: list[Notice] = []
        self.report = GuidingReport(method="OFF")
        self.parts = [Part(0, 1, CURRENT)]
        self._cells = CellModel()
        self._budget = RecordBudget(paths_per_sample, unit_pixels)

    def rehearse(self) -> Guidance:
        """Load (or compile) the kernels of learning by learning from nothing in particular."""
        records = allocate_vertex_records(_REHEARSED_RECORDS, self.settings.channel_count)
        for column in (records.normal, records.radiance, records.cache_weight):
            column[:] = 1.0
        CellModel().learn(records, _REHEARSED_RECORDS)
        return Guidance(self.settings, 0)

    def first(self) -> Guidance:
        """Guidance of the first iteration: none, but record."""
        return self.complete(Guidance(self.settings, self._budget.threshold(1)))

    def take(self, records: VertexRecords, row_count: int) -> None:
        """Learn from an iteration's records."""
        started = time.perf_counter()
        self._cells.learn(records, row_count)
        self.report.field_seconds += time.perf_counter() - started

    def complete(self, guidance: Guidance) -> Guidance:
        """Guidance whose paths end in what is known."""
        share = MEASURED_SHARE if self.settings.radiance_cache == "CONVERGING" else 0.0
        return guidance.with_cells(self._cells.field, max(guidance.record_threshold, int(share * 2**32)))

    def learn(
        self, units: Sequence[VertexRecords], recorded_share: float, sums: FilmTile, size: tuple[int, int],
        costs: IterationCosts, next_range: tuple[int, int], *, is_whole: bool = True,
    ) -> Guidance:
        """Learn from an iteration, and say how to go on; see `Learner.learn`."""
        records, row_count = join_records(units)
        self.report.record_count += row_count
        if row_count:
            self._budget.count(row_count + costs.dropped_records, recorded_share * costs.path_count)
            self.take(records, row_count)
        self.parts = [Part(*next_range, CURRENT)]
        threshold = self._budget.threshold(next_range[1])
        if next_range[0] >= EARLY_SAMPLES:
            threshold = min(threshold, int(MEASURED_SHARE * 2**32))
        return self.complete(Guidance(self.settings, threshold))

    def keep(self, units: Sequence[VertexRecords]) -> None:
        """There is nobody else who learns."""

    def compare(self, unit: Unit, film: FilmTile, costs: UnitCosts) -> None:
        """There is nothing to compare."""

    def close(self) -> None:
        """There is nothing to end."""
