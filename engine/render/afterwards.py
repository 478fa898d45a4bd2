# SPDX-License-Identifier: GPL-3.0-or-later
"""What is done when the samples are there: it may fail, and the picture may not be lost by that."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

from engine.scene.description import Notice

_T = TypeVar("_T")


class Afterwards:
    """Steps after the last sample of one render.

    Attributes
    ----------
    notices : list of Notice
        What failed.
    """

    def __init__(self) -> None:
        self.notices: list[Notice] = []

    def attempt(self, subject: str, doing: str, work: Callable[[], _T], fallback: str) -> _T | None:
        """What `work` returns; None, and a notice, where it raises."""
        try:
            return work()
        except Exception as error:  # whatever it is: hours of samples are dearer than the step
            problem = "out of memory" if isinstance(error, MemoryError) else f"{type(error).__name__}: {error}"
            self.notices.append(Notice(subject, f"{doing} failed ({problem})", fallback))
            return None
