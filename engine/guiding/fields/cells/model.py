# SPDX-License-Identifier: GPL-3.0-or-later
"""What cells learn from the records of an iteration.

A cell's radiance is the mean of what arrived at it, weighed by what the surface sends on: an unbiased estimate of each
record, so nothing is forgotten, and no record is cut: the energy is right.
"""

from __future__ import annotations

import numpy as np

from engine.guiding.fields.cells.field import (
    LEVEL_COUNT,
    SUM_COUNT,
    SUM_WEIGHT,
    CellField,
    claim_cell,
    empty_cells,
)
from engine.guiding.records.vertices import VertexRecords
from engine.kernels.vector import load
from engine.runtime.jit import kernel
from engine.state.lanes import RGB

#: The smallest cells are this share of the scene's extent: of where all but the outermost records lie.
_SMALLEST_SHARE = 1.0 / 256.0
_OUTERMOST_PERCENT = 2.0


@kernel
def _learn(cells, rows, row_count):
    """Add records to their cells of all sizes; returns how many cells found no room."""
    lost_count = 0
    for row in range(row_count):
        weight = rows.cache_weight[row]
        if not weight > 0.0:
            continue
        p, n = load(rows.position, row), load(rows.normal, row)
        for level in range(LEVEL_COUNT):
            slot = claim_cell(cells, p, n, level)
            if slot < 0:
                lost_count += 1
                continue
            for c in range(RGB):
                cells.sums[slot, c] += weight * rows.radiance[row, c]
            cells.sums[slot, SUM_WEIGHT] += weight
            cells.sums[slot, SUM_COUNT] += np.float32(1.0)
    return lost_count


class CellModel:
    """Cells of a render.

    Attributes
    ----------
    field : CellField or None, while nothing is known
    lost_count : int, records by size of cell for which the table had no room
    """

    def __init__(self) -> None:
        self.field: CellField | None = None
        self.lost_count = 0

    def learn(self, records: VertexRecords, row_count: int) -> None:
        """Add the records of an iteration; no thread may look cells up meanwhile."""
        if self.field is None:
            position = records.position[:row_count][records.cache_weight[:row_count] > 0.0]
            if not len(position):
                return
            low, high = np.percentile(position, (_OUTERMOST_PERCENT, 100.0 - _OUTERMOST_PERCENT), axis=0)
            extent = max(float((high - low).max()), 1e-6 * float(np.abs(position).max()), 1e-30)
            self.field = empty_cells(_SMALLEST_SHARE * extent)
        self.lost_count += int(_learn(self.field, records, row_count))
