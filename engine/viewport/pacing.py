# SPDX-License-Identifier: GPL-3.0-or-later
"""How coarse a view's first picture is, and when later ones follow."""

from __future__ import annotations

from engine.render.pace import Pace

#: Pace of the picture at full resolution: as Cycles' viewport at first, then at widening intervals.
PACE = Pace(times=(0.1, 0.25, 0.5, 1.0, 2.0), interval=1.25, growth=1.25, longest=8.0, poll_seconds=0.004)
#: From a change to its first picture [s]: 25 pictures a second while the view turns, and what it takes to send them.
_BUDGET = 0.034
#: Least part of the budget that is for tracing, whatever else takes its time [s].
_LEAST_TRACING = 0.008
#: An estimate may exceed the budget by this factor: else pictures of half the sides would use a quarter of it.
_TOLERANCE = 1.4
#: Divider of a view whose cost is not known yet.
_FIRST_DIVIDER = 8
_LARGEST_DIVIDER = 32
#: Weight of the newest measurement.
_NEWEST = 0.3


class Pacing:
    """Chooses the divider of the first picture by what the last ones have cost."""

    def __init__(self) -> None:
        self._seconds_per_path = 0.0
        self._overhead = 0.0

    def dividers(self, width: int, height: int) -> list[int]:
        """Dividers of the picture's sides to go through, the coarsest first, 1 last.

        Parameters
        ----------
        width, height : int
            Size of the part that is rendered, at full resolution.
        """
        divider = _FIRST_DIVIDER
        if self._seconds_per_path > 0.0:
            budget = _TOLERANCE * max(_BUDGET - self._overhead, _LEAST_TRACING)
            divider = 1
            while divider < _LARGEST_DIVIDER and self._estimate(width, height, divider) > budget:
                divider *= 2
        # A picture of one pixel says nothing, but takes time too.
        while divider > 1 and divider > max(width, height) // 4:
            divider //= 2
        return [divider >> step for step in range(divider.bit_length())]

    def _estimate(self, width: int, height: int, divider: int) -> float:
        return -(-width // divider) * -(-height // divider) * self._seconds_per_path

    def note(self, path_count: int, tracing: float, total: float) -> None:
        """Take note of what a coarse picture has cost.

        Parameters
        ----------
        path_count : int
        tracing, total : float
            Seconds of tracing, and from the change to the picture.
        """
        if path_count < 1:
            return
        self._seconds_per_path = _mix(self._seconds_per_path, tracing / path_count)
        self._overhead = _mix(self._overhead, max(total - tracing, 0.0))


def _mix(old: float, new: float) -> float:
    return new if old == 0.0 else old + _NEWEST * (new - old)
