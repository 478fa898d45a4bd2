# SPDX-License-Identifier: GPL-3.0-or-later
"""How a render's progress reads: one line for Blender's status, one for a terminal."""

from __future__ import annotations

import shutil
import sys
import time
from typing import TYPE_CHECKING, Any, TextIO

from . import console

if TYPE_CHECKING:
    pass

_BAR_WIDTH = 24


def format_duration(seconds: float | None) -> str:
    """`75` as `1:15`, `4000` as `1:06:40`; `--:--` where it is not known yet."""
    if seconds is None or not 0.0 <= seconds < 1e7:
        return "--:--"
    whole = round(seconds)
    hours, minutes = whole // 3600, whole // 60 % 60
    return f"{hours}:{minutes:02d}:{whole % 60:02d}" if hours else f"{minutes}:{whole % 60:02d}"


def format_count(value: float) -> str:
    """`1234567` as `1.23 M`."""
    for limit, suffix in ((1e9, " G"), (1e6, " M"), (1e3, " k")):
        if value >= limit:
            return f"{value / limit:.3g}{suffix}"
    return f"{value:.0f}"


def _clock(seconds: float) -> str:
    """`75.4` as `01:15.40`, `4000` as `01:06:40.00`: Cycles' way."""
    minutes, seconds = divmod(seconds, 60.0)
    hours, minutes = divmod(int(minutes), 60)
    # Cut off rather than rounded: no minute has 60 seconds.
    text = f"{minutes:02d}:{int(seconds):02d}.{int(seconds * 100.0) % 100:02d}"
    return f"{hours:02d}:{text}" if hours else text


def status_line(progress: Any, place: str = "", peak_memory: int = 0) -> str:
    """One line in Cycles' words and order: time remaining, memory, place, samples or what else is being done.

    What only we have comes last: the share of pixels that a noise threshold has left, and rays a second.

    Parameters
    ----------
    progress : object
        What `Session` hands to `on_progress`: `message`, `sample`, `samples`, `elapsed` and `remaining` [s],
        `rays_per_second`, `noisy_share` (of the pixels, None where nothing is known of noise).
    place : str
        Scene and view layer.
    peak_memory : int
        [bytes], 0 where the system does not tell.
    """
    parts = []
    if progress.remaining:
        parts.append(f"Remaining:{_clock(progress.remaining)}")
    if peak_memory:
        parts.append(f"Peak:{peak_memory / 2**20:.2f}M")
    if place:
        parts.append(place)
    if progress.sample:
        parts.append(f"Sample {progress.sample}/{progress.samples}")
    if progress.message:
        parts.append(progress.message)
    if progress.sample:
        if progress.noisy_share is not None:
            parts.append(f"{100.0 * progress.noisy_share:.3g}% of pixels left")
        parts.append(f"{format_count(progress.rays_per_second)}rays/s")
    elif progress.elapsed >= 1.0:
        parts.append(format_duration(progress.elapsed))
    return " | ".join(parts)


class TerminalBar:
    """Progress in a terminal: a bar that is redrawn, or a line now and then where the output is a file.

    Parameters
    ----------
    stream : text file or None
        None means `sys.stderr`.
    line_interval : float
        [s] between lines where the stream is no terminal.
    """

    def __init__(self, stream: TextIO | None = None, line_interval: float = 10.0) -> None:
        self._stream = stream if stream is not None else sys.stderr
        self._is_terminal = console.is_terminal(self._stream)
        self._interval = 0.1 if self._is_terminal else line_interval
        self._last_time = -1e9
        self._last_message = ""
        self._drawn = 0

    def update(self, title: str, fraction: float, progress: Any) -> None:
        """Draw, if enough time has passed or what the engine is doing has changed."""
        now = time.monotonic()
        if now - self._last_time < self._interval and progress.message == self._last_message:
            return
        self._last_time, self._last_message = now, progress.message
        filled = round(min(max(fraction, 0.0), 1.0) * _BAR_WIDTH)
        line = f"{title} [{'#' * filled}{'.' * (_BAR_WIDTH - filled)}] {100 * fraction:3.0f}% {status_line(progress)}"
        if self._is_terminal:
            line = line[: shutil.get_terminal_size().columns - 1]
            console.write(self._stream, "\r" + line.ljust(self._drawn))
            self._drawn = len(line)
        else:
            console.write(self._stream, line + "\n")

    def close(self) -> None:
        """Leave the bar's line, so that what follows starts on its own."""
        if self._drawn:
            console.write(self._stream, "\n")
            self._drawn = 0
