# SPDX-License-Identifier: GPL-3.0-or-later
"""Regions of many points at once."""

from engine.kernels.binary_tree import locate_leaf
from engine.runtime.jit import kernel


@kernel
def find_leaves(field, position, leaf):
    """Write the region that each point lies in, -1 = outside.

    Parameters
    ----------
    field : VmmField or RegionNodes
    position : float32 (R, 3), world
    leaf : int32 (R,)
    """
    for row in range(position.shape[0]):
        leaf[row] = locate_leaf(field, (position[row, 0], position[row, 1], position[row, 2]))
