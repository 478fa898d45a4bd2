# SPDX-License-Identifier: GPL-3.0-or-later
"""Random numbers of a vertex's candidates: one point, moved on around the unit cube."""

import numpy as np

from engine.kernels.constants import ONE_MINUS_EPSILON
from engine.kernels.rounding import floor_of
from engine.runtime.jit import kernel

#: Offset of a vertex's candidates among the path's dimensions, far from those of its vertices.
SET_CANDIDATES = 1 << 16

#: Powers of the inverse of the root of x^5 = x + 1 (Roberts 2018, "The Unreasonable Effectiveness of Quasirandom
#: Sequences"). The one that moves two candidates furthest apart chooses between guide and BSDF.
_STEP_0, _STEP_1 = np.float32(0.5385972), np.float32(0.6287067)
_STEP_2, _STEP_3 = np.float32(0.7338919), np.float32(0.8566749)


@kernel
def _around(u, step, j):
    """Number in [0, 1): `u` moved on by `j` steps."""
    moved = u + step * np.float32(j)
    return min(moved - floor_of(moved), ONE_MINUS_EPSILON)


@kernel
def rotated(u0, u1, u2, u3, j):
    """Point `j` of a vertex's candidates, whose first one is (u0, u1, u2, u3): 4 x float32 in [0, 1)."""
    return _around(u0, _STEP_0, j), _around(u1, _STEP_1, j), _around(u2, _STEP_2, j), _around(u3, _STEP_3, j)
