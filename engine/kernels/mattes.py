# SPDX-License-Identifier: GPL-3.0-or-later
"""Cryptomatte's slots: pairs of an id and how much of a pixel is its."""

from engine.runtime.jit import kernel

#: Id of an empty slot; no name has it (`engine.scene.cryptomatte.matte_id`).
_NO_ID = 0.0


@kernel
def add_matte(mattes, row, first, slots, matte_id, weight):
    """Add weight to an id's slot, or to the first that is free; once all belong to others, to the last.

    Parameters
    ----------
    mattes : float32 (P, M, 2)
    first, slots : int
        The slots from `first` on that are of one kind of mattes.
    """
    for slot in range(first, first + slots):
        held = mattes[row, slot, 0]
        if held == _NO_ID:
            mattes[row, slot, 0] = matte_id
            held = matte_id
        if held == matte_id or slot == first + slots - 1:
            mattes[row, slot, 1] += weight
            return


@kernel
def merge_mattes(target, rows, source, source_rows, slots, factors):
    """Add rows of `source` to rows of `target`, both float32 (_, M, 2), each with its factor.

    Parameters
    ----------
    rows, source_rows : int64 (N,)
    slots : int
        Slots of each kind of mattes.
    factors : float32 (N,)
    """
    for k in range(len(rows)):
        for slot in range(source.shape[1]):
            row = source_rows[k]
            weight = source[row, slot, 1] * factors[k]
            if weight > 0.0:
                add_matte(target, rows[k], slot - slot % slots, slots, source[row, slot, 0], weight)
