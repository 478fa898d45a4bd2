# SPDX-License-Identifier: GPL-3.0-or-later
"""When what is held has to be held anew: a worker a that hangs, b that dies, c that comes later."""

from __future__ import annotations

import pytest

from engine.cluster.place import Place

A, B, C = frozenset("a"), frozenset("b"), frozenset("c")


@pytest.mark.parametrize(
    ("place", "present", "is_safe"),
    [
        (Place(holders=A | B), A | B, True),
        # a hangs: b may ask it.
        (Place(holders=A | B), B, False),
        (Place(maker="a"), B, False),
        (Place(maker="b", allowed=B), B | C, True),
        # b is to take it while a hangs, and dies; a comes back, or c comes.
        (Place(allowed=B), A, False),
        (Place(allowed=B), C, False),
        (Place(allowed=B | C), C, True),
        # Nobody was there: whoever comes takes it.
        (Place(), C, True),
        (Place(has_failed=True), A | B | C, False),
    ],
)
def test_what_nobody_there_would_give_is_held_anew(place, present, is_safe):
    assert place.is_safe(present) == is_safe
