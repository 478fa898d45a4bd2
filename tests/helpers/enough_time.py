# SPDX-License-Identifier: GPL-3.0-or-later
"""Cases of which there are many alike come last, and in CI none begins when its time is nearly over.

A run that ends by its limit has said nothing. One that leaves out a few of a hundred like cases says so, and which.
"""

from __future__ import annotations

import os
import time
import zlib

import pytest

from tests.helpers.in_order import units

#: When no more of them begin [s since 1970].
VARIABLE = "NEURALGUIDE_LIKE_CASES_UNTIL"
#: What is said of those that are left out.
REASON = "one of many like cases, and CI's time is nearly over"
MARKER = "one_of_many"


def put_last(items: list[pytest.Item]) -> None:
    """Have all else run before such cases, and those of all kinds by turns: whatever is left out is some of each."""
    alike = [item for item in items if item.get_closest_marker(MARKER) is not None]
    unit_of = units([item.nodeid for item in alike])
    turn_of = {test: (zlib.crc32(unit.encode()), unit) for test, unit in unit_of.items()}
    items.sort(key=lambda item: (item.nodeid in turn_of, *turn_of.get(item.nodeid, (0, ""))))


def skip_if_late(item: pytest.Item) -> None:
    """Leave such a case out when it is late."""
    until = os.environ.get(VARIABLE)
    if until and item.get_closest_marker(MARKER) is not None and time.time() > float(until):
        pytest.skip(REASON)
