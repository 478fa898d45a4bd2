# SPDX-License-Identifier: GPL-3.0-or-later
"""How far a render has come, in paths."""

from __future__ import annotations

from engine.render.adaptive import ActivePixels
from engine.render.loop_state import NOTHING_DONE, LoopState
from engine.render.report import ENDINGS, Progress


class PathProgress:
    """How many paths are traced, of how many.

    Parameters
    ----------
    pixel_count, samples : int
        What there is to render.
    time_limit : float
        0: none [s].
    resumed : LoopState
        How far it had come before it was interrupted.
    """

    def __init__(
        self, pixel_count: int, samples: int, time_limit: float, resumed: LoopState = NOTHING_DONE
    ) -> None:
        self._samples, self._time_limit, self._before = samples, time_limit, resumed.seconds
        self._finished, self._expected = resumed.path_count, float(pixel_count * samples)
        self._sample = 0
        self._fraction = 0.0

    @property
    def has_paths(self) -> bool:
        """Whether any is traced."""
        return self._finished > 0

    def add(self, path_count: int, sample: int) -> None:
        """Take so many more paths, of pixels that have so many samples by now."""
        self._finished += path_count
        self._sample = max(self._sample, sample)

    @property
    def finished(self) -> int:
        """Paths that are traced."""
        return self._finished

    def expect(self, path_count: float) -> None:
        """Take how many are still to come."""
        self._expected = self._finished + path_count

    def report(
        self, elapsed: float, rays: int, ended_by: str, message: str, active: ActivePixels | None
    ) -> Progress:
        """Where it stands now. With a noise threshold nobody knows how long it takes before the first look.

        Parameters
        ----------
        elapsed : float
            Since the beginning [s].
        rays : int
            Traced by this process so far.
        ended_by : str
            Of `ENDINGS`, once it is known.
        message : str
            While that is not known.
        active : ActivePixels or None
            Which pixels go on; None: all.
        """
        share = None if active is None else active.share
        samples, limit = self._samples, self._time_limit
        fraction = min(self._finished / max(self._expected, 1.0), 1.0)
        # Where pixels have different numbers of samples, the fraction of paths does not tell them.
        sample = self._sample if active is not None else int(fraction * samples)
        remaining = None
        if fraction > 0.0 and (active is None or share is not None):
            remaining = elapsed * (1.0 - fraction) / fraction
        if limit:
            remaining = min(max(limit - elapsed, 0.0), remaining if remaining is not None else limit)
            fraction = max(fraction, min(elapsed / limit, 1.0))
        # What is expected after a look may be more than what was before.
        self._fraction = max(self._fraction, fraction)
        message = ENDINGS[ended_by] if ended_by else message
        speed = rays / max(elapsed - self._before, 1e-6)
        return Progress(self._fraction, sample, samples, elapsed, remaining, speed, message, share)
