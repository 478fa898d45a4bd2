# SPDX-License-Identifier: GPL-3.0-or-later
"""What the radiance cache learns between iterations."""

from __future__ import annotations

import time

from engine.guiding.fields.cells.model import CellModel
from engine.guiding.policy.context import RenderContext
from engine.guiding.policy.guidance import Guidance
from engine.guiding.policy.iteration import Iteration
from engine.guiding.policy.learnables.learnable import Learnable, Rehearsal
from engine.guiding.policy.standing import Standing
from engine.guiding.policy.way import ImageState, Way
from engine.guiding.records.cache_records import allocate_cache_records, join_cache_records

_REHEARSED_RECORDS = 16


class LearnedCache(Learnable):
    """Owns the cells of one render.

    Parameters
    ----------
    context : RenderContext
    standing : Standing
        The cache's.
    """

    serves_guiding = False

    def __init__(self, context: RenderContext, standing: Standing) -> None:
        self._report, self._standing = context.report, standing
        self._cells = CellModel()

    @property
    def is_over(self) -> bool:
        return self._standing.is_over

    def learn(self, iteration: Iteration) -> None:
        started = time.perf_counter()
        self._cells.learn(join_cache_records([unit.cache_records for unit in iteration.traced.units]))
        self._report.field_seconds += time.perf_counter() - started

    def complete(self, guidance: Guidance, way: Way, image: ImageState) -> Guidance:
        """Guidance whose paths end in what is known."""
        if not way.uses_cache:
            return guidance
        measured = max(guidance.record_threshold, int(way.measured_share * 2**32))
        return guidance.with_cells(self._cells.field, measured)

    def rehearse(self, rehearsal: Rehearsal) -> None:
        CellModel().learn(allocate_cache_records(_REHEARSED_RECORDS))
