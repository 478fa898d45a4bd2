# SPDX-License-Identifier: GPL-3.0-or-later
"""Following what pixels see from frame to frame, by the vectors that a render writes."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

Places = tuple[npt.NDArray[np.intp], npt.NDArray[np.intp]]
#: How far a pixel may be from where it came, once it has been followed to another frame and back [pixels].
_RETURN = 0.3


@dataclass(frozen=True)
class Sighting:
    """Where another frame shows what the pixels of a frame show.

    lag : int
        Of that frame: -1 is the one before.
    places : (rows, columns), each int (height, width)
        The nearest pixels there.
    is_seen : bool (height, width)
        False where it is hidden there, or outside the picture; `places` are some pixels then.
    """

    lag: int
    places: Places
    is_seen: npt.NDArray[np.bool_]


def offsets(vectors: np.ndarray, direction: int) -> np.ndarray:
    """Rows and columns to where the next frame (1) or the one before (-1) shows the same.

    Parameters
    ----------
    vectors : float32 (height, width, 4) [pixels]
        Blender's pass, row 0 at the bottom: x and y to the frame before, and from the frame after.

    Returns
    -------
    float32 (height, width, 2)
        0 where a vector is no number.
    """
    found = vectors[..., 1::-1] if direction < 0 else -vectors[..., 3:1:-1]
    return np.nan_to_num(found, nan=0.0, posinf=0.0, neginf=0.0)


def follow(
    vectors_of: Callable[[int], np.ndarray], frame: int, last: int, direction: int
) -> Iterator[Sighting]:
    """Follow the pixels of a frame to others, from one to the next.

    What is hidden once is lost: nothing is seen of it afterwards. It is hidden where the vectors of the other frame do
    not lead back, because they are those of something else.

    Parameters
    ----------
    vectors_of : callable
        Frame -> `offsets`' `vectors` of it, all of one size.
    frame, last : int
        Where to begin, and the last frame to look at.
    direction : int
        1 or -1: from `frame` to `last`.
    """
    height, width = vectors_of(frame).shape[:2]
    place = np.moveaxis(np.indices((height, width), np.float32), 0, 2)
    rows, columns = (np.ascontiguousarray(place[..., axis], np.intp) for axis in (0, 1))
    is_seen = np.ones((height, width), bool)
    for current in range(frame, last, direction):
        moved = place + offsets(vectors_of(current), direction)[rows, columns]
        # What is far outside has no place among whole numbers.
        moved = np.clip(moved, -1.0, np.asarray((height, width), np.float32))
        nearest = np.rint(moved).astype(np.intp)
        inside = (nearest >= 0).all(axis=2) & (nearest < (height, width)).all(axis=2)
        rows, columns = (np.clip(nearest[..., axis], 0, size - 1) for axis, size in ((0, height), (1, width)))
        returned = moved + offsets(vectors_of(current + direction), -direction)[rows, columns] - place
        is_seen = is_seen & inside & ((returned * returned).sum(axis=2) < _RETURN * _RETURN)
        place = moved
        yield Sighting(current + direction - frame, (rows, columns), is_seen)
