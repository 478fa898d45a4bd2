# SPDX-License-Identifier: GPL-3.0-or-later
"""Pieces of triangles: four alike, each of which is divided in the same way."""

import numpy as np

from engine.kernels.path import real_3
from engine.kernels.vector import dot
from engine.runtime.jit import kernel
from engine.state.lanes import POINT_FLAG_BACKFACING, POINT_FLAGS, POINT_NG

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


@kernel
def start_at(casters, paths, points, lane, direction):
    """Where photons would begin that came along `direction` to the surface that a lane has met, and to that place of
    it: a row of `PhotonMap.place_density`; -1: nowhere.
    """
    piece = piece_at(
        casters, np.int64(paths.hit_instance[lane]), np.int64(paths.hit_triangle[lane]), paths.hit_u[lane],
        paths.hit_v[lane],
    )
    if piece < 0:
        return np.int64(-1)
    # Points' normals are turned to the viewer.
    is_behind = dot(real_3(points, lane, POINT_NG), direction) < 0.0
    is_turned = points.integer[lane, POINT_FLAGS] & POINT_FLAG_BACKFACING != 0
    return 2 * piece + (1 if is_behind != is_turned else 0)
