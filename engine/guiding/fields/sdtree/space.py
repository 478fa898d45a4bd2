# SPDX-License-Identifier: GPL-3.0-or-later
"""The binary tree over space, and the sorting of records into its cells.

A cell that has seen enough records is halved. A region never disappears: the lower half keeps its cell's region, the
upper one gets a new row.
"""

from __future__ import annotations

import numpy as np

from engine.array_types import Float32Array, Int32Array
from engine.guiding.fields.sdtree.query import direction_to_square, find_blurred_region
from engine.guiding.fields.update import REJECT_NOT_FINITE, REJECT_OUTSIDE
from engine.guiding.records.light import is_usable
from engine.kernels.binary_tree import cut_leaf, find_leaf
from engine.kernels.constants import FLOAT_MAX
from engine.kernels.rng import hash_combine
from engine.kernels.vector import load
from engine.runtime.bundle import Bundle
from engine.runtime.jit import kernel

#: Estimates divide by no smaller density, see `engine.guiding.fields.table`.
_MIN_PDF = np.float32(0.01)
#: Estimates are cut off here, so that no sum of them overflows.
_LARGEST = np.float32(1e30)
_SIXTEEN_BITS = np.float32(1.0 / 65536.0)

#: Cells are not halved below this share of their coordinates (float32 tells no more apart), or of the whole box.
_RELATIVE_EXTENT = np.float32(1e-6)
_LEAST_EXTENT = np.float32(1e-12)

# Columns of a batch: where on the unit square, by how many cells to move it, radiance / pdf and the second moment.
BATCH_X = 0
BATCH_Y = 1
BATCH_SHIFT_X = 2
BATCH_SHIFT_Y = 3
BATCH_ENERGY = 4
BATCH_SQUARE = 5
BATCH_WIDTH = 6


class SpaceTree(Bundle):
    """The model's tree, of which the first nodes and regions are in use; names are those of `SdTreeField`.

    node_split : float32 (N,)
    node_link : int32 (N, 2)
    bounds, box : float32 (2, 3)
    extent : float32 (R, 3)
    corner : float32 (R, 2, 3), lowest and highest of each region's cell
    region_node : int32 (R,), each region's leaf
    """

    node_split: Float32Array
    node_link: Int32Array
    bounds: Float32Array
    box: Float32Array
    extent: Float32Array
    corner: Float32Array
    region_node: Int32Array


@kernel
def classify_records(records, start, stop, tree, is_variance_aware, region_of, counts, chunk, rejects):
    """Find the region of each record in [start, stop): -1 = rejected; and count them, for this chunk.

    Parameters
    ----------
    records : VertexRecords
    start, stop, chunk : int
    tree : SpaceTree
    region_of : int32 (M,), written
    counts : int32 (chunks, regions), row `chunk` written
    rejects : int64 (chunks, REJECT_WIDTH), row `chunk` written
    """
    for row in range(start, stop):
        region = -1
        squared = records.contribution_squared[row] if is_variance_aware else np.float32(0.0)
        if is_usable(records, row) and squared >= 0.0 and squared < FLOAT_MAX:
            region = find_leaf(tree, load(records.position, row))
            if region < 0:
                rejects[chunk, REJECT_OUTSIDE] += 1
        else:
            rejects[chunk, REJECT_NOT_FINITE] += 1
        region_of[row] = region
        if region >= 0:
            counts[chunk, region] += 1


@kernel
def classify_blurred(records, start, stop, tree, key, is_filtered, region_of, counts, chunk):
    """Find the regions that usable records in [start, stop) are splatted into, and count them.

    Parameters
    ----------
    records : VertexRecords
    tree : SpaceTree
    key : uint32, of the update
    is_filtered : bool
        Whether the region is drawn from a box about the record (Müller 2019), or the one that it lies in.
    region_of : int32 (M,), negative where rejected; rewritten
    counts : int32 (chunks, regions), row `chunk` written
    """
    for row in range(start, stop):
        if region_of[row] < 0:
            continue
        p = load(records.position, row)
        region = find_leaf(tree, p)
        if is_filtered:
            region = find_blurred_region(tree, region, p, hash_combine(key, np.uint32(row)))
        region_of[row] = region
        counts[chunk, region] += 1


@kernel
def order_records(start, stop, region_of, offsets, chunk, order):
    """Write the rows of a chunk to their regions' places in `order`.

    Parameters
    ----------
    offsets : int64 (chunks, regions), next free place for this chunk's records of a region; row `chunk` is used up
    order : int32 (M,), written
    """
    for row in range(start, stop):
        region = region_of[row]
        if region >= 0:
            order[offsets[chunk, region]] = row
            offsets[chunk, region] += 1


@kernel
def gather_records(records, start, stop, key, is_filtered, order, batch):
    """Write what quadtrees learn from rows [start, stop) of `order` to the same rows of the batch.

    Parameters
    ----------
    records : VertexRecords
    key : uint32, of the update
    is_filtered : bool
        Whether directions are moved by up to half a cell, at random.
    order : int32 (M,), usable records sorted by region
    batch : float32 (M, BATCH_WIDTH), written
    """
    channel_count = records.radiance.shape[1]
    for k in range(start, stop):
        row = np.int64(order[k])
        x, y = direction_to_square(load(records.direction, row))
        batch[k, BATCH_X] = x
        batch[k, BATCH_Y] = y
        bits = hash_combine(hash_combine(key, np.uint32(row)), np.uint32(1))
        shift_x = (np.float32(bits & np.uint32(65535)) - 32767.5) * _SIXTEEN_BITS
        shift_y = (np.float32(bits >> np.uint32(16)) - 32767.5) * _SIXTEEN_BITS
        batch[k, BATCH_SHIFT_X] = shift_x if is_filtered else np.float32(0.0)
        batch[k, BATCH_SHIFT_Y] = shift_y if is_filtered else np.float32(0.0)
        radiance = np.float32(0.0)
        for channel in range(channel_count):
            radiance += records.radiance[row, channel] / np.float32(channel_count)
        pdf = records.pdf[row]
        batch[k, BATCH_ENERGY] = min(radiance / max(pdf, _MIN_PDF), _LARGEST)
        square = records.contribution_squared[row] * pdf
        # Where it is learned from it is never NaN.
        batch[k, BATCH_SQUARE] = square if square < _LARGEST else _LARGEST


@kernel
def _choose_axis(position, order, start, stop, tree, region):
    """Axis along which to halve a region: the longest of those along which its records vary, -1 = none."""
    best = -1
    longest = np.float32(0.0)
    for axis in range(3):
        low = tree.corner[region, 0, axis]
        high = tree.corner[region, 1, axis]
        extent = high - low
        whole = tree.box[1, axis] - tree.box[0, axis]
        least = max(_RELATIVE_EXTENT * max(abs(low), abs(high)), _LEAST_EXTENT * whole)
        if not (extent > least and extent > longest):
            continue
        smallest = FLOAT_MAX
        largest = -FLOAT_MAX
        for k in range(start, stop):
            value = position[order[k], axis]
            smallest = min(smallest, value)
            largest = max(largest, value)
        if largest > smallest:
            best = axis
            longest = extent
    return best


@kernel
def _partition(position, order, start, stop, axis, split):
    """Reorder rows [start, stop) of `order`: those below `split` first. Returns the first place of the others."""
    low = start
    high = stop
    while low < high:
        if position[order[low], axis] < split:
            low += 1
            continue
        high -= 1
        if position[order[high], axis] < split:
            kept = order[low]
            order[low] = order[high]
            order[high] = kept
            low += 1
    return low


@kernel
def split_cells(position, order, rows, tree, node_count, region_count, held, source, share, parents, limit):
    """Halve the cells of regions with more than `limit` records, halves too.

    Parameters
    ----------
    position : float32 (M, 3)
    order : int32 (M,), sorted by region; reordered within a region that is cut
    rows : int64 (R, 2), each region's rows of `order`
    tree : SpaceTree, with room
    node_count, region_count : int
    held : float64 (R,), records that each region remembers
    source : int32 (R,), region before the update that a region is, or is a part of
    share : float32 (R,), of that region's statistics that it keeps; each half gets half
    parents : int32 (R,), written for new regions: the region it was cut from
    limit : float

    Returns
    -------
    New node and region counts; regions are new from the old count on, in the order in which they were made.
    """
    region = 0
    while region < region_count:
        while True:
            start = rows[region, 0]
            stop = rows[region, 1]
            full = region_count >= rows.shape[0] or node_count + 2 > tree.node_split.shape[0]
            if full or held[region] + np.float64(stop - start) <= limit:
                break
            axis = _choose_axis(position, order, start, stop, tree, region)
            if axis < 0:
                break
            split = 0.5 * tree.corner[region, 0, axis] + 0.5 * tree.corner[region, 1, axis]
            middle = _partition(position, order, start, stop, axis, split)
            node = np.int64(tree.region_node[region])
            other = region_count
            lower = node_count
            region_count += 1
            node_count += 2
            cut_leaf(tree, node, axis, split, lower, region, other)
            for k in range(3):
                tree.corner[other, 0, k] = tree.corner[region, 0, k]
                tree.corner[other, 1, k] = tree.corner[region, 1, k]
            tree.corner[region, 1, axis] = split
            tree.corner[other, 0, axis] = split
            rows[other, 0] = middle
            rows[other, 1] = stop
            rows[region, 1] = middle
            held[region] *= 0.5
            held[other] = held[region]
            share[region] *= 0.5
            share[other] = share[region]
            source[other] = source[region]
            parents[other] = region
            for side in range(2):
                child = region if side == 0 else other
                tree.region_node[child] = lower + side
                for k in range(3):
                    tree.extent[child, k] = tree.corner[child, 1, k] - tree.corner[child, 0, k]
        region += 1
    return node_count, region_count
