# SPDX-License-Identifier: GPL-3.0-or-later
"""When a render hands out images, and how often it is asked to stop."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Pace:
    """Images soon after the start, then at widening intervals.

    times : tuple of float, of the first images [s since the start]
    interval : float, from the last of these to the next [s]
    growth : float, of that interval with every image
    longest : float, interval [s]
    poll_seconds : float, between two questions whether to stop [s]
    """

    times: tuple[float, ...] = (0.1,)
    interval: float = 0.5
    growth: float = 1.6
    longest: float = 20.0
    poll_seconds: float = 0.05

    def due(self, count: int, elapsed: float) -> float:
        """When the next image is due [s since the start], `count` images after the start.

        Parameters
        ----------
        elapsed : float
            Now: images that took long push the later ones away.
        """
        if count < len(self.times):
            return self.times[count]
        return elapsed + min(self.interval * self.growth ** (count - len(self.times)), self.longest)


#: Of final renders.
FINAL = Pace()
