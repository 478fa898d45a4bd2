# SPDX-License-Identifier: GPL-3.0-or-later
"""Tests that begin in their order whatever the number of workers: `--dist loadscope` as it is here.

By `worksteal` each worker has a part of the list from the start, so that the last part's worker begins with what was to
come last. Here each takes the next few of a file when it is nearly done with those it has.
"""

from __future__ import annotations

from itertools import groupby

import pytest
from xdist.scheduler import LoadScopeScheduling

#: Tests of one file that a worker takes at once. More share what a file's tests share; fewer leave no worker alone.
_AT_ONCE = 4


class InOrder(LoadScopeScheduling):
    """Hand out a few tests of a file at a time, in the order in which they were collected."""

    _unit_of: dict[str, str]

    def schedule(self) -> None:
        """Hand out the first tests, or more."""
        if self.collection is None and self.registered_collections:
            self._unit_of = units(next(iter(self.registered_collections.values())))
            self.config.option.loadscopereorder = False
        super().schedule()

    def _split_scope(self, nodeid: str) -> str:
        return self._unit_of[nodeid]


def units(tests: list[str]) -> dict[str, str]:
    """With which others each test is run, by the name of the first of them. A file's are those that follow each other.
    """
    unit_of = {}
    for _, of_file in groupby(tests, lambda test: test.partition("::")[0]):
        together = list(of_file)
        unit_of.update({test: together[place // _AT_ONCE * _AT_ONCE] for place, test in enumerate(together)})
    return unit_of


def make_scheduler(config: pytest.Config, log: object) -> InOrder | None:
    """The scheduler of `--dist loadscope`; others are xdist's own."""
    return InOrder(config, log) if config.getoption("dist") == "loadscope" else None
