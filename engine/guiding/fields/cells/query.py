# SPDX-License-Identifier: GPL-3.0-or-later
"""Asking cells: which size a path asks first, where it is, and which one answers."""

import numpy as np

from engine.guiding.fields.cells.field import LEVEL_COUNT, SUM_COUNT, cell_key, cell_size, find_cell
from engine.runtime.jit import kernel

#: Sides of the smallest and the largest cell that is asked, over that of the path's footprint: finer ones are noisier,
#: and nobody sees it; what lies behind an edge would leak through larger ones.
_FINEST_SHARE = np.float32(0.125)
_LARGEST_SHARE = np.float32(0.5)
#: Records that a cell must have.
LEAST_COUNT = np.float32(32.0)


@kernel
def _first_level(cells, side):
    """Level of the smallest cells that a path of a footprint of this side [m] asks."""
    level = 0
    while level + 1 < LEVEL_COUNT and cell_size(cells, level + 1) <= _FINEST_SHARE * side:
        level += 1
    return level


@kernel
def first_key(cells, p, n, program, side):
    """Place and tag of the cell that is asked first (`cell_key`), so that its memory can be asked for ahead.

    Parameters
    ----------
    p : tuple of 3 float32, world [m]; n : tuple of 3 float32, unit, geometric
    program : int, of the surface's shader
    side : float32 [m], of the path's footprint
    """
    return cell_key(cells, p, n, program, _first_level(cells, side))


@kernel
def look_up(cells, place, tag, p, n, program, side):
    """A cell that knows enough and is small beside the path's footprint, from `first_key` on; -1: none."""
    level = _first_level(cells, side)
    while level < LEVEL_COUNT and cell_size(cells, level) <= _LARGEST_SHARE * side:
        slot = find_cell(cells, place, tag)
        if slot >= 0 and cells.sums[slot, SUM_COUNT] >= LEAST_COUNT:
            return slot
        level += 1
        place, tag = cell_key(cells, p, n, program, level)
    return np.int64(-1)
