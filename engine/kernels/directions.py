# SPDX-License-Identifier: GPL-3.0-or-later
"""Which of the six directions along the axes a vector points to most."""

from engine.runtime.jit import kernel

#: Directions along the axes.
DIRECTION_COUNT = 6


@kernel
def axis_faced(n):
    """Which of six directions a vector of any length is nearest to: int in [0, DIRECTION_COUNT)."""
    x, y, z = abs(n[0]), abs(n[1]), abs(n[2])
    if x >= y and x >= z:
        return 0 if n[0] >= 0.0 else 1
    if y >= z:
        return 2 if n[1] >= 0.0 else 3
    return 4 if n[2] >= 0.0 else 5
