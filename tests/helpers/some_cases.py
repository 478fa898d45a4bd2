# SPDX-License-Identifier: GPL-3.0-or-later
"""Some of many cases of one kind: what CI has time for. With NEURALGUIDE_ALL_CASES set, all of them."""

from __future__ import annotations

import os
import zlib
from collections.abc import Iterable, Sequence
from typing import TypeVar

_Case = TypeVar("_Case")

#: Set for every case, as before a release, or after a change that may touch any of them.
VARIABLE = "NEURALGUIDE_ALL_CASES"


def some_of(cases: Iterable[str], every: int) -> list[str]:
    """Every so many of the cases: chosen by their names, so that a new one changes no other's turn.

    Parameters
    ----------
    cases : iterable of str
        All of them, each with a name of its own.
    every : int
        One in so many is chosen.
    """
    return [case for case in cases if has_all() or zlib.crc32(case.encode()) % every == 0]


def every(cases: Sequence[_Case], step: int) -> Sequence[_Case]:
    """The first of a few cases that are written out, and every `step`-th after it."""
    return cases if has_all() else cases[::step]


def has_all() -> bool:
    """Whether all cases were asked for."""
    return bool(os.environ.get(VARIABLE))
