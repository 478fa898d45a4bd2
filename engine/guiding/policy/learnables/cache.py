# SPDX-License-Identifier: GPL-3.0-or-later
"""What the radiance cache learns between iterations."""

from __future__ import annotations

import time

from engine.guiding.fields.cells.model import CellModel
from engine.guiding.policy.facts import RenderFacts
from engine.guiding.policy.guidance import Guidance
from engine.guiding.policy.iteration import Iteration
from engine.guiding.policy.learnables.face import Learnable, Rehearsal
from engine.guiding.policy.standing import Standing
from engine.guiding.policy.way import ImageState, Way
from engine.guiding.records.taught import allocate_taught_records, join_taught

_REHEARSED_RECORDS = 16


class LearnedCache(Learnable):
    """Owns the cells of one render.

    Parameters
    ----------
    facts : RenderFacts
    standing : Standing
        The cache's.
    """

    def __init__(self, facts: RenderFacts, standing: Standing) -> None:
        self._report, self._standing = facts.report, standing
        self._cells = CellModel()

    @property
    def is_over(self) -> bool:
        return self._standing.is_over

    def learn(self, iteration: Iteration) -> None:
        started = time.perf_counter()
        self._cells.learn(join_taught([unit.taught for unit in iteration.traced.units]))
        self._report.field_seconds += time.perf_counter() - started

    def complete(self, guidance: Guidance, way: Way, image: ImageState) -> Guidance:
        """Guidance whose paths end in what is known."""
        if not way.uses_cache:
            return guidance
        measured = max(guidance.record_threshold, int(way.measured_share * 2**32))
        return guidance.with_cells(self._cells.field, measured)

    def rehearse(self, rehearsal: Rehearsal) -> None:
        CellModel().learn(allocate_taught_records(_REHEARSED_RECORDS))
