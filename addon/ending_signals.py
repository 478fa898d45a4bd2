# SPDX-License-Identifier: GPL-3.0-or-later
"""Signals that ask a process to end: what is rendered is kept first."""

from __future__ import annotations

import contextlib
import signal
import threading
from collections.abc import Callable, Iterator
from typing import Any

#: Ctrl-C, schedulers of farms, a terminal that is closed, a limit on processor time, and Ctrl-Break on Windows.
_NAMES = ("SIGINT", "SIGTERM", "SIGHUP", "SIGXCPU", "SIGBREAK")


def handle(handler: Callable[[int, Any], None]) -> dict[int, Any]:
    """Have a handler called for all of them; returns who handled them before."""
    previous = {}
    for number in _numbers():
        # Who asks for a render that outlives the terminal (nohup) gets one.
        if number == signal.SIGINT or signal.getsignal(number) is not signal.SIG_IGN:
            previous[number] = signal.signal(number, handler)
    return previous


class Delay:
    """Signals that would end the process at once, of which a render is told first.

    Attributes
    ----------
    number : int
        The signal that came first, 0 while none has.
    """

    def __init__(self) -> None:
        self.number = 0

    @contextlib.contextmanager
    def until_over(self) -> Iterator[None]:
        """Within it they are noted; after it the process ends by the one that came.

        Only the main thread can do this, and is asked soon enough only where it renders: in background. Whoever handles
        a signal already goes on to.
        """
        if threading.current_thread() is not threading.main_thread():
            yield
            return
        delayed = [number for number in _numbers() if signal.getsignal(number) is signal.SIG_DFL]
        for number in delayed:
            signal.signal(number, self._note)
        try:
            yield
        finally:
            for number in delayed:
                signal.signal(number, signal.SIG_DFL)
            if self.number:
                signal.raise_signal(self.number)

    def _note(self, number: int, _frame: Any) -> None:
        self.number = self.number or number


def _numbers() -> list[int]:
    return [getattr(signal, name) for name in _NAMES if hasattr(signal, name)]
