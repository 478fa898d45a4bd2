# SPDX-License-Identifier: GPL-3.0-or-later
"""Memory that Python and kernels have freed and the C library keeps: of many renders, hundreds of megabytes.

glibc gives each thread an arena of its own and returns what is free at an arena's end only. Others return it by
themselves.
"""

from __future__ import annotations

import ctypes
import sys
from collections.abc import Callable
from functools import cache


def give_back() -> None:
    """Return free memory to the system, where the C library does not by itself. Takes milliseconds."""
    trim = _trim()
    if trim is not None:
        trim(0)


@cache
def _trim() -> Callable[[int], int] | None:
    """glibc's `malloc_trim`, None elsewhere."""
    if sys.platform != "linux":
        return None
    try:
        trim = ctypes.CDLL(None).malloc_trim
    except (OSError, AttributeError):  # another C library
        return None
    trim.argtypes, trim.restype = (ctypes.c_size_t,), ctypes.c_int
    return trim
