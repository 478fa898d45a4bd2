# SPDX-License-Identifier: GPL-3.0-or-later
"""What cells learn of the radiance that surfaces send back, from the records of an iteration.

Small cells have few records, and one that has met no bright path yet would end those to come. So a cell's moments are
mixed with those of the large cell around it, which counts like `_PRIOR` records, and a large cell's with those of all.
"""

from __future__ import annotations

import numpy as np

from engine.guiding.fields.hash_grid import extent_of
from engine.guiding.fields.roulette.field import (
    LEVEL_COUNT,
    RouletteField,
    claim_roulette_cell,
    copy_of_roulette_field,
    empty_roulette_field,
    roulette_key,
)
from engine.guiding.records.vertices import VertexRecords
from engine.kernels.vector import load
from engine.runtime.jit import kernel

#: The smallest cells are this share of the scene's extent (`extent_of`).
_SMALLEST_SHARE = 1.0 / 32.0
#: Records that the larger cell around a cell counts for.
_PRIOR = 16.0
#: Largest share of an iteration's sum of squares that a single record may have, and so many times the mean where there
#: are few: one bright path must not make all others long that meet its cells, or, by what cells have in common, any.
_OUTLIER_SHARE = 0.01
_OUTLIER_MEANS = 8.0
#: About so many records of an iteration are looked at, for all threads wait meanwhile.
_MOST_RECORDS = 1 << 16

# Columns of the sums.
_COUNT, _SQUARE, _COST = 0, 1, 2
_WIDTH = 3


@kernel
def _add(field, sums, level_of, parent_of, records, row_count, step, most):
    """Add every `step`-th record to its cells of all sizes; returns how often there was no room.

    Parameters
    ----------
    sums : float64 (S, _WIDTH)
    level_of, parent_of : int64 (S,), of each cell: its level, and the larger cell around it, -1 = none
    most : float64, squares are cut off here
    """
    lost_count = 0
    for row in range(0, row_count, step):
        p, n = load(records.position, row), load(records.normal, row)
        parent = np.int64(-1)
        for larger in range(LEVEL_COUNT):
            level = LEVEL_COUNT - 1 - larger
            place, tag = roulette_key(field, p, n, records.program[row], level)
            slot = claim_roulette_cell(field, place, tag)
            if slot < 0:
                lost_count += 1
                continue
            level_of[slot] = level
            parent_of[slot] = parent
            parent = slot
            sums[slot, _COUNT] += 1.0
            sums[slot, _SQUARE] += min(np.float64(records.outgoing_radiance[row]) ** 2, most)
            sums[slot, _COST] += records.cost[row]
    return lost_count


class RouletteFieldModel:
    """Cells of a render.

    Attributes
    ----------
    field : RouletteField or None, while nothing is known
    lost_count : int, records by size of cell for which the table had no room
    """

    def __init__(self) -> None:
        self.field: RouletteField | None = None
        self.lost_count = 0
        self._sums = np.zeros((0, _WIDTH))
        self._level = self._parent = np.zeros(0, np.int64)

    def learn(self, records: VertexRecords, row_count: int) -> None:
        """Add the records of an iteration; what threads look into meanwhile stays as it is."""
        if not row_count:
            return
        if self.field is None:
            extent = extent_of(records.position[:row_count])
            self.field = empty_roulette_field(_SMALLEST_SHARE * extent)
            slot_count = len(self.field.tag)
            self._sums = np.zeros((slot_count, _WIDTH))
            self._level, self._parent = np.full(slot_count, -1, np.int64), np.full(slot_count, -1, np.int64)
        else:
            self.field = copy_of_roulette_field(self.field)
        step = max(row_count // _MOST_RECORDS, 1)
        squares = np.square(records.outgoing_radiance[:row_count:step], dtype=np.float64)
        most = max(_OUTLIER_SHARE * float(squares.sum()), _OUTLIER_MEANS * float(squares.mean()))
        self.lost_count += int(_add(self.field, self._sums, self._level, self._parent, records, row_count, step, most))
        self._estimate(self.field)

    def _estimate(self, field: RouletteField) -> None:
        """Make importances of the sums, those of the largest cells first."""
        known = np.flatnonzero(self._level >= 0)
        level, parent, sums = self._level[known], self._parent[known], self._sums[known]
        total = sums[level == LEVEL_COUNT - 1].sum(axis=0)
        moments = np.empty_like(sums)
        # A cell without a larger one around it has the moments of all.
        by_slot = np.empty_like(self._sums)
        by_slot[known] = moments[:] = total / max(total[_COUNT], 1.0)
        for size in reversed(range(LEVEL_COUNT)):
            cells = np.flatnonzero(level == size)
            around = by_slot[np.where(parent[cells] >= 0, parent[cells], known[cells])]
            moments[cells] = (sums[cells] + _PRIOR * around) / (sums[cells, :1] + _PRIOR)
            by_slot[known[cells]] = moments[cells]
        field.importance[known] = np.sqrt(moments[:, _SQUARE] / np.maximum(moments[:, _COST], 1.0))
