# SPDX-License-Identifier: GPL-3.0-or-later
"""Finding by looks what moves otherwise than its surface: highlights, reflections, what is seen through glass."""

from __future__ import annotations

import os
from concurrent.futures import ThreadPoolExecutor

import numpy as np

from engine.denoise.motion import Places
from engine.runtime.jit import kernel

#: Pixels to each side of where the surface is that are looked at, and how many shifts that makes.
_REACH = 2
_SIDE = 2 * _REACH + 1
_SHIFT_COUNT = _SIDE * _SIDE
#: What a pixel further from there has to be more alike by, per pixel: squared differences over what noise leaves.
_PER_PIXEL = 1.0
#: Rows that a thread takes at once.
_BAND = 64


@kernel
def _shift_of(index):
    """How many pixels down and to the right a shift is."""
    return index // _SIDE - _REACH, index % _SIDE - _REACH


@kernel
def _match_rows(picture, sharpness, other, rows, columns, first, last, costs, found_rows, found_columns):
    """Find the most alike pixels for the rows from `first` to `last`, that one left out.

    picture, other : float32 (height, width, 3)
    sharpness : float32 (height, width), what squared differences are multiplied by
    rows, columns : int64 (height, width), where in `other` to look
    costs : float32 (3, 25, width), room to work in
    found_rows, found_columns : int64 (height, width), written
    """
    height, width = rows.shape
    for row in range(first - 1, last + 1):
        if 0 <= row < height:
            for shift in range(_SHIFT_COUNT):
                down, right = _shift_of(shift)
                for column in range(width):
                    r = min(max(rows[row, column] + down, 0), height - 1)
                    c = min(max(columns[row, column] + right, 0), width - 1)
                    total = 0.0
                    for channel in range(3):
                        apart = picture[row, column, channel] - other[r, c, channel]
                        total += apart * apart
                    costs[row % 3, shift, column] = total * sharpness[row, column]
        done = row - 1
        if done < first:
            continue
        for column in range(width):
            least, best = np.inf, 0
            for shift in range(_SHIFT_COUNT):
                down, right = _shift_of(shift)
                total, count = 0.0, 0
                for near in range(max(done - 1, 0), min(done + 2, height)):
                    for beside in range(max(column - 1, 0), min(column + 2, width)):
                        total += costs[near % 3, shift, beside]
                        count += 1
                cost = total / count + _PER_PIXEL * np.sqrt(np.float32(down * down + right * right))
                if cost < least:
                    least, best = cost, shift
            down, right = _shift_of(best)
            found_rows[done, column] = min(max(rows[done, column] + down, 0), height - 1)
            found_columns[done, column] = min(max(columns[done, column] + right, 0), width - 1)


def most_alike(
    picture: np.ndarray, sharpness: np.ndarray, other: np.ndarray, places: Places, *, threads: int = 0
) -> Places:
    """Near where another frame shows the surface of a pixel, the pixel around which it looks most alike.

    Parameters
    ----------
    picture, other : float32 (height, width, 3)
    sharpness : float32 (height, width)
        One over the squared difference, a sum over channels, by which pixels differ by chance. Squares are compared in
        windows of 3 x 3; one more is what a pixel to the side is worth.
    places : (rows, columns), each int (height, width)
        Within `other`.
    threads : int
        0 = all.

    Returns
    -------
    (rows, columns), each int (height, width)
    """
    height, width = picture.shape[:2]
    found = np.empty((height, width), np.int64), np.empty((height, width), np.int64)
    rows, columns = (np.ascontiguousarray(axis, np.int64) for axis in places)
    images = [np.ascontiguousarray(image, np.float32) for image in (picture, sharpness, other)]

    def match(first: int) -> None:
        costs = np.empty((3, _SHIFT_COUNT, width), np.float32)
        _match_rows(*images, rows, columns, first, min(first + _BAND, height), costs, *found)

    with ThreadPoolExecutor(threads or os.cpu_count()) as pool:
        list(pool.map(match, range(0, height, _BAND)))
    return found
