# SPDX-License-Identifier: GPL-3.0-or-later
"""How many samples a render still has time for, so that all pixels have the same number when the clock ends it.

A *pass* is some samples of every tile. As long as much time is left, passes are as long as is wanted. Near the end they
get shorter, until the last ones are of two samples or one: where one of these is cut off, tiles differ by no more.
"""

from __future__ import annotations

import time

#: Share of the samples that seem to fit which a long pass may have: the machine may be slower meanwhile.
_SURE_SHARE = 0.5
#: Samples of a pass that may be cut off.
SHORTEST_PASS = 2


class TimeLeft:
    """How long passes take, and how many samples the next may have.

    Parameters
    ----------
    limit : float [s]
        Limit of the whole render; 0: there is none.
    before : float [s]
        Time that it has taken before it was interrupted.
    """

    def __init__(self, limit: float, before: float = 0.0) -> None:
        self._limit, self.before = limit, before
        self._start: float | None = None
        #: Samples and time at the begin of the last pass.
        self._began = (0, before)
        self._seconds_per_sample = 0.0

    @property
    def is_limited(self) -> bool:
        """Whether there is a limit."""
        return self._limit > 0.0

    @property
    def is_up(self) -> bool:
        """Whether the limit is reached."""
        return self.is_limited and self.elapsed >= self._limit

    def begin(self) -> None:
        """Time runs from here on."""
        self._start = time.perf_counter() - self.before

    @property
    def has_begun(self) -> bool:
        """Whether `begin` was called."""
        return self._start is not None

    @property
    def elapsed(self) -> float:
        """Time since `begin`, with what was before [s]."""
        return self.before if self._start is None else time.perf_counter() - self._start

    def fit(self, wanted: int, first: int) -> int:
        """Samples of the pass that begins now.

        Parameters
        ----------
        wanted : int
            That it would have with time enough, at least 1.
        first : int
            Samples that every tile has by now, or is about to have.
        """
        elapsed = self.elapsed
        before, at = self._began
        if first > before:
            self._seconds_per_sample = (elapsed - at) / (first - before)
            self._began = (first, elapsed)
        if not self.is_limited or first == 0 or not self._seconds_per_sample > 0.0:
            return wanted
        sure = int(min(_SURE_SHARE * (self._limit - elapsed) / self._seconds_per_sample, float(wanted)))
        return min(wanted, max(sure, SHORTEST_PASS))

    def is_short(self, first: int, count: int) -> bool:
        """Whether a pass is one of the last before the limit, which may be cut off: nothing is won back of what it
        teaches."""
        return self.is_limited and first > 0 and count <= SHORTEST_PASS
