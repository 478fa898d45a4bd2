# SPDX-License-Identifier: GPL-3.0-or-later
"""A bake for tests that ask what becomes of any."""

from __future__ import annotations

import numpy as np

from engine.scene.bake import Bake


def first_triangle(width: int, height: int) -> Bake:
    """All pixels look at one place of the first triangle of the first instance."""
    size = height, width
    return Bake(0, np.zeros(size, np.int32), np.full((*size, 2), 0.3, np.float32), np.zeros((*size, 4), np.float32))
