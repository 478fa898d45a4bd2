# SPDX-License-Identifier: GPL-3.0-or-later
"""Copies that were never moved off what they are copies of: rays start in place on both.

Rays that leave one of the two a rounding error off would be beyond the other, and see nothing of it. In Cycles such
surfaces shadow each other.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from engine.builder.world_boxes import WorldBoxes, are_round, has_triangles
from engine.state.geometry import GeometryArrays


def unmoved_copies(geometry: GeometryArrays, boxes: WorldBoxes) -> npt.NDArray[np.bool_]:
    """Instances that are in one place with another one: bool (I,).

    Those are whose boxes agree to the last bit, so that it does not matter whether they share a mesh, or how a face is
    divided. Others whose boxes agree by chance lose time, not light.

    Parameters
    ----------
    boxes : WorldBoxes
        Boxes of all instances.
    """
    found = np.zeros(len(boxes.extent), bool)
    rows = np.flatnonzero(has_triangles(geometry) & ~are_round(geometry) & np.isfinite(boxes.extent))
    # Most are told apart by one number, which takes a hundredth of the time of telling them apart by all. No product of
    # matrices, which may round alike rows in different ways.
    x, y, z = (boxes.low[rows] + boxes.high[rows] * 0.618).T
    key = x + y * 0.755 + z * 0.570
    order = np.argsort(key)
    rows, key = rows[order], key[order]
    is_alike = np.zeros(len(rows) + 1, bool)
    is_alike[1:-1] = key[1:] == key[:-1]
    rows = rows[is_alike[1:] | is_alike[:-1]]
    if len(rows):
        corners = np.concatenate([boxes.low[rows], boxes.high[rows]], axis=1)
        _, which, counts = np.unique(corners, axis=0, return_inverse=True, return_counts=True)
        found[rows] = counts[which.ravel()] > 1
    return found
