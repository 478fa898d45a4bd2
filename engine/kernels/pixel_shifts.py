# SPDX-License-Identifier: GPL-3.0-or-later
"""By which digits a pixel's Sobol points are shifted against those of its neighbours.

A pixel's shift is the XOR of columns, one for each set bit of its place in the block of 8 x 8. Columns are such that
2^k samples of each of 2^q pixels, neighbours in the order of places, are a (t, k + q, 2)-net with a small t in any two
of the four dimensions, for all k at once: sections of one sequence would be that for one k only.
`python -m tools.pixel_shifts` has found them.
"""

import numpy as np

#: Bits of a pixel's place: three of its column, three of its row.
PLACE_BITS = 6
#: Bits of columns that the search has chosen: of digits beyond, no number of samples that matters has any use.
DIGITS = 16
#: By dimension and bit of the place, the finest first: the first digit of a shift is the lowest bit.
COLUMNS = (
    (0x177F, 0x15D5, 0x7533, 0xC9BB, 0x221A, 0x0124),
    (0x06FF, 0x39AA, 0x47CB, 0x54D9, 0xEACE, 0x9FE3),
    (0x2CF6, 0xB349, 0xE12B, 0x0858, 0x7B9B, 0x8F5F),
    (0xE6F7, 0xFDAD, 0x7134, 0xBF11, 0xFDDF, 0x685E),
)


def shift_table() -> np.ndarray:
    """Shifts by place in `engine.kernels.rng.pixel_hash`: bit-reversed words, as Sobol points are kept there.

    Returns
    -------
    uint32, shape (2**PLACE_BITS, 4 dimensions)
    """
    table = np.zeros((1 << PLACE_BITS, len(COLUMNS)), np.uint32)
    for place in range(1 << PLACE_BITS):
        for bit in range(PLACE_BITS):
            # The finest is a place's highest bit.
            if place >> (PLACE_BITS - 1 - bit) & 1:
                table[place] ^= np.array([columns[bit] for columns in COLUMNS], np.uint32)
    return table
