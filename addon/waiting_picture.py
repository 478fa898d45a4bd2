# SPDX-License-Identifier: GPL-3.0-or-later
"""What Blender's window shows while there is no picture yet: a bar that grows, where it would show black."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt

#: Scene-linear greys: of the picture, of the bar, and of what the bar has filled.
_GREY, _EMPTY, _FILLED = 0.1, 0.05, 0.4
#: Nothing is shown while the render may come sooner, and then so often [s].
_PATIENCE, _INTERVAL = 1.0, 0.5


def waiting_picture(height: int, width: int, fraction: float) -> npt.NDArray[np.float32]:
    """A grey picture with a bar, filled to `fraction`.

    Returns
    -------
    float32 (height, width, 4)
    """
    picture = np.full((height, width, 4), _GREY, np.float32)
    low, high = height * 12 // 25, max(height * 13 // 25, height * 12 // 25 + 1)
    left, right = width // 5, max(width - width // 5, width // 5 + 1)
    picture[low:high, left:right] = _EMPTY
    picture[low:high, left : left + round((right - left) * min(max(fraction, 0.0), 1.0))] = _FILLED
    picture[..., 3] = 1.0
    return picture


class WaitingPicture:
    """Shows the bar while a render says that it compiles or builds, until the first picture is there.

    Parameters
    ----------
    show : callable (float32 (height, width, 4)) -> None
    height, width : int
    """

    def __init__(self, show: Callable[[npt.NDArray[np.float32]], None], height: int, width: int) -> None:
        self._show, self._height, self._width = show, height, width
        self._next = time.monotonic() + _PATIENCE

    def update(self, progress: Any) -> None:
        """Show how far it is, if it is time to."""
        now = time.monotonic()
        if progress.sample == 0 and now >= self._next:
            self._next = now + _INTERVAL
            self._show(waiting_picture(self._height, self._width, progress.fraction))

    def end(self) -> None:
        """The first picture is there."""
        self._next = float("inf")
