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
def first_level(cells, side):
    """Level of the cells that a path asks first.

    Parameters
    ----------
    side : float32 [m], of the path's footprint
    """
    level = 0
    while level + 1 < LEVEL_COUNT and cell_size(cells, level + 1) <= _FINEST_SHARE * side:
        level += 1
    return level


@kernel
def is_small(cells, level, side):
    """Whether cells of a level are small enough for a path with a footprint of this side [m] to ask them."""
    return cell_size(cells, level) <= _LARGEST_SHARE * side


@kernel
def look_up(cells, level, place, tag, p, n, program, side):
    """A cell that knows enough and is small beside the path's footprint; -1: none.

    Parameters
    ----------
    level : int, of the cell that is asked first, which is small (`first_level`, `is_small`)
    place : int, tag : uint32, of that cell (`cell_key`)
    p : tuple of 3 float32, world [m]; n : tuple of 3 float32, unit, geometric
    program : int, of the surface's shader
    side : float32 [m], of the path's footprint
    """
    while True:
        slot = find_cell(cells, place, tag)
        if slot >= 0 and cells.sums[slot, SUM_COUNT] >= LEAST_COUNT:
            return slot
        level += 1
        if level >= LEVEL_COUNT or not is_small(cells, level, side):
            return np.int64(-1)
        place, tag = cell_key(cells, p, n, program, level)
