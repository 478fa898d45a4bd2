# SPDX-License-Identifier: GPL-3.0-or-later
"""Python's garbage collector, kept out of the way while kernels compile.

Numba's data of a kernel are kept, in millions of small objects: looking for rubbish among them takes a seventh of the
time of compiling, and finds little.
"""

from __future__ import annotations

import gc
from functools import cache

from numba.core import event


class _Pause(event.Listener):
    """Turns collection off while something compiles. Numba compiles one at a time, and callees within their callers."""

    def __init__(self) -> None:
        self._depth = 0
        self._was_on = False

    def on_start(self, event: event.Event) -> None:
        """A kernel, or one that it calls, begins to compile."""
        if not self._depth:
            self._was_on = gc.isenabled()
            gc.disable()
        self._depth += 1

    def on_end(self, event: event.Event) -> None:
        """It is compiled, or has failed."""
        self._depth -= 1
        if not self._depth and self._was_on:
            gc.enable()


@cache
def collect_nothing_while_compiling() -> None:
    """From now on, in this process."""
    event.register("numba:compile", _Pause())
