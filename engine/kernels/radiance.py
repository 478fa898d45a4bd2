# SPDX-License-Identifier: GPL-3.0-or-later
"""Adding light to a path: the power heuristic and clamping, shared by every stage that finds light."""

import numpy as np

from engine.jit import kernel


@kernel
def power_heuristic(pdf, other_pdf):
    """MIS weight of a technique of density `pdf` against one of `other_pdf` (same measure).

    References: Veach 1997, Eq. (9.13), beta = 2. Written so that squares do not overflow.
    """
    if pdf <= 0.0:
        return 0.0 * pdf
    ratio = other_pdf / pdf
    return 1.0 / (1.0 + ratio * ratio)


@kernel
def add_radiance(paths, lane, contribution, row, depth, clamp_direct, clamp_indirect, weight):
    """Add row `row` of `contribution` (float32 (N, C)) to the path, clamped as Cycles does, `weight` times.

    `depth` counts scatterings before the light's last one: 0 is direct light. The limits are on the sum of channels,
    as many times the user's setting as there are; 0 = none. They are on the contribution before it is weighted, so that
    they take the same share of the light however seldom it is sampled.
    """
    limit = clamp_indirect if depth > 0 else clamp_direct
    factor = limit * 0.0 + 1.0
    if limit > 0.0:
        total = 0.0 * limit
        for c in range(len(paths.channels)):
            total += abs(contribution[row, c])
        limit *= np.float32(len(paths.channels))
        if total > limit:
            factor = limit / total
    for c in range(len(paths.channels)):
        paths.radiance[lane, c] += factor * weight * contribution[row, c]
