# SPDX-License-Identifier: GPL-3.0-or-later
"""Light groups of a view's pictures: passes that are asked for, and the mix of what has come."""

from __future__ import annotations

import numpy as np

from engine.viewport.mixing import group_passes, mixed_picture

GROUPS = ("Key", "Fill")


def test_passes_are_asked_for_where_there_is_a_mix() -> None:
    assert group_passes(GROUPS, None) == group_passes(GROUPS, {}) == frozenset()
    assert group_passes(GROUPS, {"Key": (1.0, 1.0, 1.0)}) == {"Combined_Key", "Combined_Fill"}


def test_each_group_is_multiplied_and_alpha_stays() -> None:
    images = {
        "Combined": np.full((2, 3, 4), 0.75, np.float32), "Combined_Key": np.full((2, 3, 3), 0.5, np.float32),
        "Combined_Fill": np.full((2, 3, 3), 0.25, np.float32),
    }  # fmt: skip
    found = mixed_picture(images, GROUPS, {"Key": (0.0, 1.0, 3.0), "Gone": (9.0, 9.0, 9.0)})
    assert np.array_equal(found, np.tile(np.float32([0.25, 0.75, 1.75, 0.75]), (2, 3, 1)))
    assert mixed_picture(images, GROUPS, {"Key": (1.0, 1.0, 1.0)}) is images["Combined"]
    assert mixed_picture({"Combined": images["Combined"]}, GROUPS, {"Key": (2.0, 2.0, 2.0)}) is images["Combined"]
