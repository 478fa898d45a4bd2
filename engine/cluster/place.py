# SPDX-License-Identifier: GPL-3.0-or-later
"""Where what is held for workers is, and whether all of them can get it from there."""

from __future__ import annotations

from collections.abc import Set
from dataclasses import dataclass


@dataclass(frozen=True)
class Place:
    """What a scheduler knows of one thing that is held.

    holders : addresses of who has it
    maker : address of who was asked to take it and has not yet; '': nobody was
    allowed : addresses of those who may be asked; empty: anybody may
    has_failed : bool, whether the scheduler has given it up
    """

    holders: frozenset[str] = frozenset()
    maker: str = ""
    allowed: frozenset[str] = frozenset()
    has_failed: bool = False

    def is_safe(self, present: Set[str]) -> bool:
        """Whether nobody waits in vain for it while these workers are there, and answer.

        Whoever fetches it asks any of its holders, so that one who hangs is enough for him to wait for ever. And it is
        not to wait for those who may take it while none of them is there, whoever else is.
        """
        if self.has_failed:
            return False
        if self.holders:
            return self.holders <= present
        if self.maker:
            return self.maker in present
        return not self.allowed or bool(self.allowed & present)
