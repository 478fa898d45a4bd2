# SPDX-License-Identifier: GPL-3.0-or-later
"""The adaptive kd-tree over space, and the sorting of records into its leaves.

A leaf that has seen enough samples is cut at their mean along the axis on which they vary most. A region never
disappears: the left child keeps the leaf's region, the right one gets a new row.
"""

from __future__ import annotations

import numpy as np

from engine.array_types import Float32Array, Int32Array
from engine.guiding.fields.update import REJECT_NOT_FINITE, REJECT_OUTSIDE
from engine.guiding.fields.vmm.field import NEIGHBOR_COUNT
from engine.guiding.fields.vmm.store import (
    MOMENT_COUNT,
    MOMENT_MEAN,
    MOMENT_SQUARED,
    MOMENT_WIDTH,
    SAMPLE_DIRECTION,
    SAMPLE_DISTANCE,
    SAMPLE_P,
    SAMPLE_PDF,
    SAMPLE_RADIANCE,
    SAMPLE_WEIGHT,
    SAMPLE_WIDTH,
)
from engine.guiding.records.light import is_usable
from engine.kernels.binary_tree import GRID_SIDE, LEAF, NODE_AXIS, NODE_CHILD, cut_leaf, find_leaf
from engine.kernels.constants import FLOAT_MAX
from engine.kernels.vector import load
from engine.runtime.bundle import Bundle
from engine.runtime.jit import kernel

#: A cell is never cut where its samples vary by less than this share of the coordinate itself.
_RELATIVE_DEVIATION = np.float32(1e-6)

#: Distance of a split from a cell [cells] from which it is beyond doubt on which side the cell lies.
_GRID_MARGIN = np.float32(1e-2)


class TreeNodes(Bundle):
    """The model's tree, N nodes of which the first are in use; the arrays are those of `VmmField`.

    node_split : float32 (N,)
    node_link : int32 (N, 2)
    node_depth : int32 (N,)
    bounds : float32 (2, 3)
    """

    node_split: Float32Array
    node_link: Int32Array
    node_depth: Int32Array
    bounds: Float32Array


@kernel
def classify_records(records, start, stop, tree, region_of, counts, chunk, rejects):
    """Find the region of each record in [start, stop): -1 = rejected; and count them, for this chunk.

    Parameters
    ----------
    records : Records
    start, stop, chunk : int
    tree : TreeNodes
    region_of : int32 (R,), written
    counts : int32 (chunks, regions), row `chunk` written
    rejects : int64 (chunks, REJECT_WIDTH), row `chunk` written
    """
    for row in range(start, stop):
        region = -1
        if is_usable(records, row) and records.distance[row] >= 0.0:
            region = find_leaf(tree, load(records.position, row))
            if region < 0:
                rejects[chunk, REJECT_OUTSIDE] += 1
        else:
            rejects[chunk, REJECT_NOT_FINITE] += 1
        region_of[row] = region
        if region >= 0:
            counts[chunk, region] += 1


@kernel
def scatter_records(records, start, stop, region_of, offsets, chunk, min_pdf, batch):
    """Write the records of a chunk to their regions' rows of the batch, in their order.

    Parameters
    ----------
    records : Records
    start, stop, chunk : int
    region_of : int32 (R,), of `classify_records`
    offsets : int64 (chunks, regions), next free row for this chunk's records of a region; row `chunk` is used up
    min_pdf : float32 [sr^-1], a weight divides by no less
    batch : float32 (M, SAMPLE_WIDTH), written
    """
    channel_count = records.radiance.shape[1]
    for row in range(start, stop):
        region = region_of[row]
        if region < 0:
            continue
        target = offsets[chunk, region]
        offsets[chunk, region] = target + 1
        for axis in range(3):
            batch[target, SAMPLE_P + axis] = records.position[row, axis]
            batch[target, SAMPLE_DIRECTION + axis] = records.direction[row, axis]
        batch[target, SAMPLE_DISTANCE] = records.distance[row]
        pdf = records.pdf[row]
        batch[target, SAMPLE_PDF] = pdf
        total = np.float32(0.0)
        for channel in range(channel_count):
            value = records.radiance[row, channel]
            batch[target, SAMPLE_RADIANCE + channel] = value
            total += value / np.float32(channel_count)
        batch[target, SAMPLE_WEIGHT] = min(total / max(pdf, np.float32(min_pdf)), FLOAT_MAX)


@kernel
def add_moments(batch, start, stop, moments, region):
    """Merge the positions of batch rows [start, stop) into a region's count, mean and squared deviations.

    References: Chan, Golub and LeVeque 1979, for merging two sets.
    """
    count = np.float64(stop - start)
    if not count > 0.0:
        return
    old = moments[region, MOMENT_COUNT]
    for axis in range(3):
        base = np.float64(batch[start, SAMPLE_P + axis])
        total = np.float64(0.0)
        squared = np.float64(0.0)
        for row in range(start, stop):
            value = np.float64(batch[row, SAMPLE_P + axis]) - base
            total += value
            squared += value * value
        mean = total / count
        deviation = max(squared - total * mean, 0.0)
        change = base + mean - moments[region, MOMENT_MEAN + axis]
        moments[region, MOMENT_MEAN + axis] += change * count / (old + count)
        moments[region, MOMENT_SQUARED + axis] += deviation + change * change * old * count / (old + count)
    moments[region, MOMENT_COUNT] = old + count


@kernel
def choose_split(moments, region):
    """Axis and coordinate at which to cut a region: axis -1 if its samples all lie in one place."""
    axis = -1
    count = moments[region, MOMENT_COUNT]
    best = np.float64(0.0)
    for k in range(3):
        variance = moments[region, MOMENT_SQUARED + k] / max(count, 1.0)
        floor = abs(moments[region, MOMENT_MEAN + k]) * _RELATIVE_DEVIATION
        if variance > best and variance > floor * floor:
            best = variance
            axis = k
    coordinate = np.float32(moments[region, MOMENT_MEAN + max(axis, 0)])
    return axis, coordinate


@kernel
def partition_batch(batch, start, stop, axis, split):
    """Reorder batch rows [start, stop): those below `split` first. Returns the first row of the others."""
    low = start
    high = stop
    while low < high:
        if batch[low, SAMPLE_P + axis] < split:
            low += 1
            continue
        high -= 1
        if batch[high, SAMPLE_P + axis] < split:
            for column in range(SAMPLE_WIDTH):
                kept = batch[low, column]
                batch[low, column] = batch[high, column]
                batch[high, column] = kept
            low += 1
    return low


@kernel
def split_leaves(batch, tree, node_count, moments, starts, region_leaf, region_count, parents, limits):
    """Add a batch's positions to its leaves and cut those that have seen enough, children too, down to the last.

    Parameters
    ----------
    batch : float32 (M, SAMPLE_WIDTH), sorted by region; reordered within a region that is cut
    tree : TreeNodes, with room
    node_count, region_count : int
    moments : float64 (R, MOMENT_WIDTH)
    starts : int64 (R, 2), each region's rows of the batch
    region_leaf : int32 (R,), each region's node
    parents : int32 (R,), written for new regions: the region it was cut from
    limits : float64 (2,), samples in a leaf that is cut; greatest depth

    Returns
    -------
    New node and region counts; regions are new from the old count on, in the order in which they were made.
    """
    capacity = moments.shape[0]
    region = 0
    while region < region_count:
        start = starts[region, 0]
        stop = starts[region, 1]
        if parents[region] < 0:
            add_moments(batch, start, stop, moments, region)
        while True:
            node = np.int64(region_leaf[region])
            depth = np.int64(tree.node_depth[node])
            full = region_count >= capacity or node_count + 2 > tree.node_split.shape[0]
            if full or moments[region, MOMENT_COUNT] <= limits[0] or np.float64(depth) >= limits[1]:
                break
            axis, split = choose_split(moments, region)
            if axis < 0:
                break
            middle = partition_batch(batch, starts[region, 0], starts[region, 1], axis, split)
            other = region_count
            left = node_count
            region_count += 1
            node_count += 2
            cut_leaf(tree, node, axis, split, left, region, other)
            for side in range(2):
                child = region if side == 0 else other
                tree.node_depth[left + side] = depth + 1
                region_leaf[child] = left + side
            starts[other, 0] = middle
            starts[other, 1] = starts[region, 1]
            starts[region, 1] = middle
            parents[other] = region
            # Each child counts from here: what it knows of positions is what this batch shows.
            for child in (region, other):
                for column in range(MOMENT_WIDTH):
                    moments[child, column] = 0.0
                add_moments(batch, starts[child, 0], starts[child, 1], moments, child)
        region += 1
    return node_count, region_count


def make_grid(tree: TreeNodes) -> tuple[Int32Array, Float32Array]:
    """`VmmField.grid` and `grid_scale` of a tree."""
    extent = tree.bounds[1] - tree.bounds[0]
    scale = (GRID_SIDE / np.maximum(extent, np.finfo(np.float32).tiny)).astype(np.float32)
    grid = np.zeros(GRID_SIDE**3, np.int32)
    _fill_grid(tree, scale, grid)
    return grid, scale


@kernel
def _fill_grid(tree, scale, grid):
    """Descend for every cell as long as it lies on one side, by more than rounding could move a point."""
    for cell in range(grid.shape[0]):
        index = (cell // (GRID_SIDE * GRID_SIDE), cell // GRID_SIDE % GRID_SIDE, cell % GRID_SIDE)
        node = np.int64(0)
        axis = tree.node_link[0, NODE_AXIS]
        while axis != LEAF:
            step = index[0] if axis == 0 else (index[1] if axis == 1 else index[2])
            split = (tree.node_split[node] - tree.bounds[0, axis]) * scale[axis]
            side = -1
            if split < step - _GRID_MARGIN:
                side = 1
            elif split > step + 1 + _GRID_MARGIN:
                side = 0
            if side < 0:
                break
            node = np.int64(tree.node_link[node, NODE_CHILD]) + side
            axis = tree.node_link[node, NODE_AXIS]
        grid[cell] = node


@kernel
def find_neighbors(pivots, is_ready, first, last, neighbors, neighbor_pivots):
    """For regions [first, last): the ready regions whose pivots are closest to theirs, closest first.

    Parameters
    ----------
    pivots : float32 (R, 3)
    is_ready : uint8 (R,)
    neighbors : int32 (R, NEIGHBOR_COUNT), written; -1 = none
    neighbor_pivots : float32 (R, 3, NEIGHBOR_COUNT), written
    """
    for region in range(first, last):
        for k in range(NEIGHBOR_COUNT):
            neighbors[region, k] = -1
            for axis in range(3):
                neighbor_pivots[region, axis, k] = 1e18
        for other in range(pivots.shape[0]):
            if is_ready[other] == 0:
                continue
            distance = np.float32(0.0)
            for axis in range(3):
                apart = pivots[other, axis] - pivots[region, axis]
                distance += apart * apart
            _insert_neighbor(pivots, region, other, distance, neighbors, neighbor_pivots)


@kernel
def _insert_neighbor(pivots, region, other, distance, neighbors, neighbor_pivots):
    """Put a candidate into a region's sorted list if it is among the closest."""
    k = NEIGHBOR_COUNT
    while k > 0:
        held = np.float32(0.0)
        for axis in range(3):
            apart = neighbor_pivots[region, axis, k - 1] - pivots[region, axis]
            held += apart * apart
        if neighbors[region, k - 1] >= 0 and held <= distance:
            break
        k -= 1
        if k + 1 < NEIGHBOR_COUNT:
            neighbors[region, k + 1] = neighbors[region, k]
            for axis in range(3):
                neighbor_pivots[region, axis, k + 1] = neighbor_pivots[region, axis, k]
    if k < NEIGHBOR_COUNT:
        neighbors[region, k] = other
        for axis in range(3):
            neighbor_pivots[region, axis, k] = pivots[other, axis]
