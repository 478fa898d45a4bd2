# SPDX-License-Identifier: GPL-3.0-or-later
"""A grid without an end, whose cells share buckets by a hash.

References: Teschner et al. 2003, "Optimized Spatial Hashing for Collision Detection of Deformable Objects".
"""

import math

import numpy as np

from engine.runtime.jit import kernel

#: Cells further out than this share the outermost: far coordinates must stay integers.
_FARTHEST = np.float32(1e9)
#: Cells of a block along an axis are two to this power.
BLOCK_BITS = 2


@kernel
def _index(x, inverse_cell):
    return np.int64(math.floor(min(max(x * inverse_cell, -_FARTHEST), _FARTHEST)))


@kernel
def cell_of(p, inverse_cell):
    """The cell of a point: three int64."""
    return _index(p[0], inverse_cell), _index(p[1], inverse_cell), _index(p[2], inverse_cell)


@kernel
def first_of_block(x, y, z, part, mask):
    """Bucket of the first cell of a block, all of whose cells are counted in blocks."""
    block = x * np.int64(73856093) ^ y * np.int64(19349663) ^ z * np.int64(83492791)
    return (block ^ part * np.int64(39916801)) << 6 & mask


@kernel
def place_in_block(x, y, z):
    """Which of its block's cells a cell is, in [0, 64)."""
    small = x & 1 | (y & 1) << 1 | (z & 1) << 2
    return (x & 2) << 2 | (y & 2) << 3 | (z & 2) << 4 | small


@kernel
def bucket_of(x, y, z, part, mask):
    """Bucket of a part of a cell; `mask` is their number, a power of two, less 1.

    Cells of a block of 4 x 4 x 4 lie next to each other, those of 2 x 2 x 2 too, since who asks for one asks for its
    neighbours.
    """
    block = first_of_block(x >> BLOCK_BITS, y >> BLOCK_BITS, z >> BLOCK_BITS, part, mask)
    return block | place_in_block(x, y, z) & mask


@kernel
def sort_into_buckets(positions, parts, inverse_cell, mask, starts, order):
    """Order points by bucket, those of a bucket as they came.

    Parameters
    ----------
    positions : float32 (P, >= 3), the first three columns are coordinates [m]
    parts : int64 (P,), by which points of a cell are told apart, as of other times
    inverse_cell : float32 [m^-1]
    mask : int
    starts : int32 (mask + 2,), zeros; filled with each bucket's first place in `order`
    order : int32 (P,), filled with rows of `positions`
    """
    count = positions.shape[0]
    for row in range(count):
        x, y, z = cell_of((positions[row, 0], positions[row, 1], positions[row, 2]), inverse_cell)
        starts[bucket_of(x, y, z, parts[row], mask) + 1] += 1
    for bucket in range(mask + 1):
        starts[bucket + 1] += starts[bucket]
    # Each bucket's start moves to its end, which is the next one's start.
    for row in range(count - 1, -1, -1):
        x, y, z = cell_of((positions[row, 0], positions[row, 1], positions[row, 2]), inverse_cell)
        bucket = bucket_of(x, y, z, parts[row], mask)
        starts[bucket + 1] -= 1
        order[starts[bucket + 1]] = row
    # starts[b + 1] is now where bucket b begins.
    for bucket in range(mask + 1):
        starts[bucket] = starts[bucket + 1]
    starts[mask + 1] = count


@kernel
def note_occupied(starts, bucket_count):
    """Say by a bit behind `starts` which buckets hold something.

    Parameters
    ----------
    starts : int32, `engine.state.photons.bucket_starts`, as `sort_into_buckets` has filled them
    bucket_count : int, B, a multiple of BLOCK_CELLS
    """
    for bucket in range(bucket_count):
        if starts[bucket + 1] > starts[bucket]:
            starts[bucket_count + 1 + (bucket >> 5)] |= np.int32(np.int64(1) << (bucket & 31))


@kernel
def occupied_of_block(starts, bucket_count, first):
    """Which cells of a block hold something, by `place_in_block`: the bits of an int64.

    Parameters
    ----------
    starts, bucket_count
        As `note_occupied` leaves them.
    first : int, `first_of_block`
    """
    word = bucket_count + 1 + (first >> 5)
    return np.int64(starts[word]) & np.int64(0xFFFFFFFF) | np.int64(starts[word + 1]) << 32
