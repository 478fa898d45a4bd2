# SPDX-License-Identifier: GPL-3.0-or-later
"""Telling records of collisions with media from those of surfaces."""

from __future__ import annotations

import numpy as np

from engine.guiding.records.vertices import VertexRecords


def is_collision(rows: VertexRecords, row_count: int) -> np.ndarray:
    """Which of the first records are of collisions, bool (row_count,): those without a surface, and so no program."""
    collides: np.ndarray = rows.program[:row_count] < 0
    return collides
