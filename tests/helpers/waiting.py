# SPDX-License-Identifier: GPL-3.0-or-later
"""Waiting for what other processes and threads do: until it has happened, however busy the machine is."""

from __future__ import annotations

import time
from collections.abc import Callable

#: What takes longer never happens [s]. Nothing depends on it but how long a test hangs that fails.
NEVER = 900.0


def wait_until(condition: Callable[[], bool], nap: float = 0.01) -> None:
    """Return once `condition` holds."""
    started = time.monotonic()
    while not condition():
        assert time.monotonic() - started < NEVER, "it never happened"
        time.sleep(nap)
