# SPDX-License-Identifier: GPL-3.0-or-later
"""What cells learn from the records of an iteration.

A cell's radiance is the mean of what its surfaces sent back along the paths that met them, weighed by what these paths
bring of it to the camera. Guided paths come more often to where a cell is bright, with less weight each: a plain mean
would be too bright. Each channel has weights of its own: a path that comes from something red says nothing of blue.

Paths whose footprints are too small for a cell, or so large that they ask larger ones, come to other parts of it:
near an edge, for example, from the wall beside it, where it is dark. They weigh less.
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
    copy_cells,
    empty_cells,
)
from engine.guiding.fields.cells.query import first_level, is_small
from engine.guiding.fields.hash_grid import extent_of
from engine.guiding.records.cache_records import CacheRecords
from engine.kernels.prefetch import prefetch
from engine.kernels.vector import load
from engine.runtime.jit import kernel
from engine.state.lanes import RGB

#: The smallest cells are this share of the scene's extent (`extent_of`).
_SMALLEST_SHARE = 1.0 / 256.0
_ROWS_AHEAD = 8
#: Weight of paths that would not ask cells of this size.
_OTHERS_SHARE = np.float32(0.1)


@kernel
def _learn(cells, rows, level, shares, places, tags):
    """Add rows to their cells of a level; returns how many found no room.

    Parameters
    ----------
    shares : float32, places : int64, tags : uint32, a row each, scratch
    """
    row_count = rows.program.shape[0]
    for row in range(row_count):
        first = first_level(cells, rows.side[row])
        places[row], tags[row] = cell_key(
            cells, load(rows.position, row), load(rows.normal, row), rows.program[row], level
        )
        asks = level >= first and is_small(cells, level, rows.side[row])
        shares[row] = np.float32(1.0) if asks else _OTHERS_SHARE
    lost_count = 0
    for row in range(row_count):
        prefetch(cells.tag, places[min(row + _ROWS_AHEAD, row_count - 1)])
        slot = claim_cell(cells, places[row], tags[row])
        if slot < 0:
            lost_count += 1
            continue
        for c in range(RGB):
            weight = shares[row] * rows.weight[row, c]
            cells.sums[slot, c] += weight * rows.radiance[row, c]
            cells.sums[slot, SUM_WEIGHT + c] += weight
        cells.sums[slot, SUM_COUNT] += np.float32(1.0)
    return lost_count


class CellModel:
    """Cells of a render.

    There are two tables in turns: paths that are traced while a learning goes on look into what the one before left.

    Attributes
    ----------
    field : CellField or None, while nothing is known
    lost_count : int, records by size of cell for which the table had no room
    """

    def __init__(self) -> None:
        self.field: CellField | None = None
        self._spare: CellField | None = None
        self.lost_count = 0

    def learn(self, records: CacheRecords) -> None:
        """Add the records of an iteration. Threads may look into the field meanwhile, but not into earlier ones."""
        row_count = len(records.program)
        if not row_count:
            return
        if self.field is None:
            extent = extent_of(records.position)
            field = empty_cells(_SMALLEST_SHARE * extent)
        else:
            field = self._spare or empty_cells(float(self.field.size[0]), len(self.field.tag))
            copy_cells(self.field, field)
        scratch = [np.zeros(row_count, kind) for kind in (np.float32, np.int64, np.uint32)]
        for level in range(LEVEL_COUNT):
            self.lost_count += int(_learn(field, records, level, *scratch))
        self.field, self._spare = field, self.field
