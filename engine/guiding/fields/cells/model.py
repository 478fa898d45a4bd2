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
    cell_key,
    claim_cell,
    empty_cells,
)
from engine.guiding.records.vertices import VertexRecords
from engine.kernels.prefetch import prefetch
from engine.kernels.vector import load
from engine.runtime.jit import kernel
from engine.state.lanes import RGB

#: The smallest cells are this share of the scene's extent: of where all but the outermost records lie.
_SMALLEST_SHARE = 1.0 / 256.0
_OUTERMOST_PERCENT = 2.0
_ROWS_AHEAD = 8


@kernel
def _learn(cells, rows, taught, taught_count, level, places, tags):
    """Add the rows that teach to their cells of a level; returns how many found no room.

    Parameters
    ----------
    taught : int64 (>= taught_count,), rows
    places : int64, tags : uint32, (>= taught_count,), scratch
    """
    for k in range(taught_count):
        row = taught[k]
        places[k], tags[k] = cell_key(cells, load(rows.position, row), load(rows.normal, row), level)
    lost_count = 0
    for k in range(taught_count):
        prefetch(cells.tag, places[min(k + _ROWS_AHEAD, taught_count - 1)])
        row = taught[k]
        slot = claim_cell(cells, places[k], tags[k])
        if slot < 0:
            lost_count += 1
            continue
        weight = rows.cache_weight[row]
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
        taught = np.flatnonzero(records.cache_weight[:row_count] > 0.0)
        if not len(taught):
            return
        if self.field is None:
            position = records.position[taught]
            low, high = np.percentile(position, (_OUTERMOST_PERCENT, 100.0 - _OUTERMOST_PERCENT), axis=0)
            extent = max(float((high - low).max()), 1e-6 * float(np.abs(position).max()), 1e-30)
            self.field = empty_cells(_SMALLEST_SHARE * extent)
        places, tags = np.zeros(len(taught), np.int64), np.zeros(len(taught), np.uint32)
        for level in range(LEVEL_COUNT):
            self.lost_count += int(_learn(self.field, records, taught, len(taught), level, places, tags))
