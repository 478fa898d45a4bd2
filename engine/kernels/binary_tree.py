# SPDX-License-Identifier: GPL-3.0-or-later
"""The binary tree over space that fields find their regions by: its nodes, looking up a point, and cutting a leaf.

A field, or the model that makes it, has the nodes in `node_split`, float32 (N,), and `node_link`, int32 (N, 2), and the
space that they divide in `bounds`, float32 (2, 3). Node 0 is the root. Fields that are looked up at every vertex have a
grid besides: `grid`, int32 (GRID_SIDE**3,), the smallest node that contains a cell of the bounds, in C order of x, y,
z, and `grid_scale`, float32 (3,), cells per metre.
"""

from __future__ import annotations

import numpy as np

from engine.runtime.jit import kernel

# Columns of node_link
NODE_AXIS = 0
#: The lower child (the upper one follows it), or a leaf's region.
NODE_CHILD = 1

#: NODE_AXIS of a leaf.
LEAF = -1
#: Cells along each axis of the grid by which leaves are found.
GRID_SIDE = 32


@kernel
def find_leaf(field, p):
    """Region whose cell holds point p: int, -1 = outside the field's bounds (or p is NaN)."""
    if not is_inside(field, p):
        return -1
    return descend(field, 0, p)


@kernel
def locate_leaf(field, p):
    """The same as `find_leaf` of a published field: from the grid's cell on, not from the root."""
    if not is_inside(field, p):
        return -1
    cell = 0
    for axis in range(3):
        steps = int((p[axis] - field.bounds[0, axis]) * field.grid_scale[axis])
        cell = cell * GRID_SIDE + min(max(steps, 0), GRID_SIDE - 1)
    return descend(field, np.int64(field.grid[cell]), p)


@kernel
def is_inside(field, p):
    """Whether a point lies within the bounds; NaN does not."""
    return (
        p[0] >= field.bounds[0, 0]
        and p[1] >= field.bounds[0, 1]
        and p[2] >= field.bounds[0, 2]
        and p[0] <= field.bounds[1, 0]
        and p[1] <= field.bounds[1, 1]
        and p[2] <= field.bounds[1, 2]
    )


@kernel
def descend(field, node, p):
    """Region of the leaf below a node that holds point p."""
    axis = field.node_link[node, NODE_AXIS]
    while axis != LEAF:
        coordinate = p[0] if axis == 0 else (p[1] if axis == 1 else p[2])
        node = field.node_link[node, NODE_CHILD] + (1 if coordinate >= field.node_split[node] else 0)
        axis = field.node_link[node, NODE_AXIS]
    return np.int64(field.node_link[node, NODE_CHILD])


@kernel
def cut_leaf(tree, node, axis, split, lower, region, other):
    """Divide a leaf: what lies below `split` stays `region`, the rest is `other`.

    Parameters
    ----------
    tree : bundle with the nodes
    node, lower : int
        The leaf, and the first of the two nodes, new and side by side, that become its children.
    axis : int
    split : float32
    region, other : int
    """
    tree.node_split[node] = split
    tree.node_link[node, NODE_AXIS] = axis
    tree.node_link[node, NODE_CHILD] = lower
    tree.node_link[lower, NODE_AXIS] = LEAF
    tree.node_link[lower, NODE_CHILD] = region
    tree.node_link[lower + 1, NODE_AXIS] = LEAF
    tree.node_link[lower + 1, NODE_CHILD] = other
