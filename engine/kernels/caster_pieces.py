# SPDX-License-Identifier: GPL-3.0-or-later
"""Pieces of triangles: four alike, each of which is divided in the same way."""

import numpy as np

from engine.runtime.jit import kernel

_HALF = np.float32(0.5)


@kernel
def place_in_piece(piece, level, u, v):
    """Barycentrics on a triangle of a place on one of its pieces.

    Parameters
    ----------
    piece : int in [0, 4 ** level)
    level : int
    u, v : float32, barycentrics on the piece
    """
    for k in range(level):
        # The smallest pieces first.
        part = (piece >> 2 * (level - 1 - k)) & 3
        if part == 0:
            u, v = u * _HALF, v * _HALF
        elif part == 1:
            u, v = (u + np.float32(1.0)) * _HALF, v * _HALF
        elif part == 2:
            u, v = u * _HALF, (v + np.float32(1.0)) * _HALF
        else:
            # The one in the middle is upside down.
            u, v = (np.float32(1.0) - u) * _HALF, (np.float32(1.0) - v) * _HALF
    return u, v


@kernel
def piece_of_place(level, u, v):
    """Which piece of a triangle a place is on; what `place_in_piece` takes."""
    piece, place = np.int64(0), np.int64(1)
    for _ in range(level):
        if u + v <= _HALF:
            part = 0
            u, v = u + u, v + v
        elif u >= _HALF:
            part = 1
            u, v = u + u - np.float32(1.0), v + v
        elif v >= _HALF:
            part = 2
            u, v = u + u, v + v - np.float32(1.0)
        else:
            part = 3
            u, v = np.float32(1.0) - u - u, np.float32(1.0) - v - v
        piece += part * place
        place *= 4
    return piece


@kernel
def piece_at(casters, instance, triangle, u, v):
    """The piece of all casters that a place is on; -1: photons begin nowhere there."""
    first = casters.first_row[instance]
    if first < 0:
        return np.int64(-1)
    row = first + triangle - casters.triangle[first]
    if casters.first_piece[row] < 0:
        return np.int64(-1)
    return casters.first_piece[row] + piece_of_place(casters.level[row], u, v)
