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
    (0x5CFF, 0x9795, 0x1E4C, 0x9F07, 0x50C3, 0x72C9),
    (0x8AFF, 0x156A, 0x68A2, 0x1E24, 0x17D7, 0xB367),
    (0x19F6, 0x2B5B, 0xF931, 0xD625, 0x08A1, 0xA2F3),
    (0x76F7, 0x99AD, 0xC48B, 0x3E39, 0x0A16, 0x351B),
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
