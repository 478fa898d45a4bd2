# SPDX-License-Identifier: GPL-3.0-or-later
"""Where the places of a bake are."""

from __future__ import annotations

import numpy as np

from engine.scene.bake import Bake


def test_the_region_holds_all_places_and_no_more() -> None:
    triangles = np.full((5, 7), -1, np.int32)
    bake = Bake(0, triangles, np.zeros((5, 7, 2), np.float32), np.zeros((5, 7, 4), np.float32))
    triangles[1, 4] = triangles[3, 2] = 0
    assert bake.region == (2, 1, 5, 4)
