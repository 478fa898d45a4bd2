# SPDX-License-Identifier: GPL-3.0-or-later
"""The directional quadtrees while they learn: splatting, what becomes the density, and refinement.

Quadtrees of all regions lie one after the other in a pool; within one, a node comes before its children, so loops over
nodes, up or down, stand for recursion.

References: Müller et al. 2017, "Practical Path Guiding for Efficient Light-Transport Simulation", section 3.2; Müller
2019, "Practical Path Guiding in Production"; Rath et al. 2020, "Variance-Aware Path Guiding".
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from engine.array_types import Float32Array, Int32Array
from engine.guiding.fields.sdtree.field import QUAD_LEAF, SPLIT_PHI, SPLIT_Z
from engine.guiding.fields.sdtree.space import (
    BATCH_ENERGY,
    BATCH_SHIFT_X,
    BATCH_SHIFT_Y,
    BATCH_SQUARE,
    BATCH_X,
    BATCH_Y,
)
from engine.kernels.constants import ONE_MINUS_EPSILON
from engine.runtime.bundle import Bundle
from engine.runtime.jit import kernel

#: No record may hold a larger share of what its region sees in an update (unless there are hardly any).
_RECORD_SHARE = np.float32(0.02)
#: Each takes one and a half orders of magnitude off an outlier.
_LIMIT_ROUNDS = 40
#: A node's quadrants are taken for alike until its records tell them apart: against so many of them.
_PRIOR_RECORDS = np.float32(2.0)
#: Sums below this are no light: their ratios mean nothing.
_LEAST_SUM = np.float32(1e-35)
#: No half has less probability than this share: what random numbers of 24 bits can draw.
_LEAST_SPLIT = np.float32(2.0**-23)
#: Nodes of one quadtree.
MAX_NODES = 4096

# Columns of what is measured by region.
MEASURE_ENERGY_LIMIT = 0
MEASURE_SQUARE_LIMIT = 1
MEASURE_ENERGY = 2
MEASURE_SQUARE = 3
MEASURE_WIDTH = 4

# Columns of what a region remembers besides its quadtree.
TOTAL_COUNT = 0
TOTAL_ENERGY = 1
TOTAL_WIDTH = 2


class QuadPool(Bundle):
    """Quadtrees of R regions, Q nodes.

    root : int32 (R + 1,), first node of each region, and the end
    child : int32 (Q, 4), as in `SdTreeField`
    sums : float32 (Q, 4), energy (or its second moment) of each quadrant, up to date in leaves only
    squares : float32 (Q, 4), sum of the squares of all that was added to `sums`, likewise
    """

    root: Int32Array
    child: Int32Array
    sums: Float32Array
    squares: Float32Array


class RefineScratch(Bundle):
    """One thread's workspace of `refine_tree`, by node of the new quadtree.

    links : int32 (MAX_NODES, 2), node of the old tree (-1 = none), depth
    quarters : float64 (MAX_NODES, 3), value, sum and square of each quadrant of a node that the old tree lacks
    """

    links: Int32Array
    quarters: npt.NDArray[np.float64]


def allocate_refine_scratch() -> RefineScratch:
    """Zeroed `RefineScratch`."""
    return RefineScratch(np.zeros((MAX_NODES, 2), np.int32), np.zeros((MAX_NODES, 3)))


@kernel
def copy_trees(first, last, source, share, old, pool):
    """Write regions [first, last) as copies of their sources, with a share of their sums.

    Parameters
    ----------
    source : int32 (R,), region of the old pool
    share : float32 (R,)
    old, pool : QuadPool
        All of `pool` but its root is written.
    """
    for region in range(first, last):
        start = np.int64(old.root[source[region]])
        target = np.int64(pool.root[region])
        for k in range(np.int64(pool.root[region + 1]) - target):
            for q in range(4):
                pool.child[target + k, q] = old.child[start + k, q]
                pool.sums[target + k, q] = old.sums[start + k, q] * share[region]
                pool.squares[target + k, q] = old.squares[start + k, q] * share[region]


@kernel
def _measure(batch, start, stop, column):
    """Largest value that one of the rows may have in a column, and the sum with all others cut off there.

    The limit is a share of that sum, or the third largest value if that is larger: what is bright but rare is believed
    when it is seen three times.
    """
    total = np.float64(0.0)
    lit_count = 0
    first = np.float32(0.0)
    second = np.float32(0.0)
    third = np.float32(0.0)
    for k in range(start, stop):
        value = batch[k, column]
        total += np.float64(value)
        lit_count += 1 if value > 0.0 else 0
        third = max(third, min(value, second))
        second = max(second, min(value, first))
        first = max(first, value)
    share = np.float64(max(_RECORD_SHARE, 2.0 / np.float32(max(lit_count, 1))))
    limit = max(total * share, np.float64(third))
    # An outlier raises its own limit: the sum is taken again without the excess, until there is none.
    for _round in range(_LIMIT_ROUNDS):
        total = np.float64(0.0)
        for k in range(start, stop):
            total += min(np.float64(batch[k, column]), limit)
        lower = max(total * share, np.float64(third))
        if not lower < 0.99 * limit:
            break
        limit = lower
    return limit, total


@kernel
def measure_regions(batch, rows, first, last, is_variance_aware, measures):
    """Write the limits of records and the sums of regions [first, last).

    Parameters
    ----------
    batch : float32 (M, BATCH_WIDTH), sorted by region
    rows : int64 (R, 2), each region's rows
    measures : float64 (R, MEASURE_WIDTH), written
    """
    for region in range(first, last):
        start = rows[region, 0]
        stop = rows[region, 1]
        limit, total = _measure(batch, start, stop, BATCH_ENERGY)
        measures[region, MEASURE_ENERGY_LIMIT] = limit
        measures[region, MEASURE_ENERGY] = total
        if is_variance_aware:
            limit, total = _measure(batch, start, stop, BATCH_SQUARE)
            measures[region, MEASURE_SQUARE_LIMIT] = limit
            measures[region, MEASURE_SQUARE] = total


@kernel
def _find_leaf(child, root, x, y):
    """Node and quadrant of the leaf that holds a point, and its side's length."""
    node = np.int64(root)
    size = np.float32(0.5)
    while True:
        x *= 2.0
        y *= 2.0
        column = 1 if x >= 1.0 else 0
        row = 1 if y >= 1.0 else 0
        x -= np.float32(column)
        y -= np.float32(row)
        quadrant = column + 2 * row
        below = np.int64(child[node, quadrant])
        if below == QUAD_LEAF:
            return node, quadrant, size
        node = root + below
        size *= 0.5


@kernel
def splat_regions(batch, rows, first, last, column, limit_column, scale, measures, pool):
    """Add a batch to the quadtrees of regions [first, last).

    A record's direction is moved by up to half the size of the leaf it falls into (a box filter, by one random point of
    the box), round the sphere in phi and back at the poles, where the square ends.

    Parameters
    ----------
    batch : float32 (M, BATCH_WIDTH), sorted by region
    rows : int64 (R, 2)
    column, limit_column : int, of the batch and of `measures`
    scale : float32, factor of all
    measures : float64 (R, MEASURE_WIDTH)
    pool : QuadPool
    """
    child, sums, squares = pool.child, pool.sums, pool.squares
    for region in range(first, last):
        start = np.int64(pool.root[region])
        limit = np.float32(measures[region, limit_column])
        for k in range(rows[region, 0], rows[region, 1]):
            value = batch[k, column]
            if not value > 0.0:
                continue
            x = batch[k, BATCH_X]
            y = batch[k, BATCH_Y]
            _node, _quadrant, size = _find_leaf(child, start, x, y)
            x += batch[k, BATCH_SHIFT_X] * size
            y += batch[k, BATCH_SHIFT_Y] * size
            x += 1.0 if x < 0.0 else np.float32(0.0)
            x -= 1.0 if x >= 1.0 else np.float32(0.0)
            y = abs(y)
            y = 2.0 - y if y >= 1.0 else y
            node, quadrant, size = _find_leaf(child, start, min(x, ONE_MINUS_EPSILON), min(y, ONE_MINUS_EPSILON))
            added = min(value, limit) * scale
            sums[node, quadrant] += added
            squares[node, quadrant] += added * added


@kernel
def _split(part, whole):
    """Share of a part, float32, neither 0 nor 1."""
    return np.float32(min(max(part / whole, _LEAST_SPLIT), 1.0 - _LEAST_SPLIT))


@kernel
def _even_share(sums, squares, node):
    """Weight of the prior against a node's records: 1 where these are none, near 0 where many share its energy.

    The number of records is the effective one, (sum)^2 / (sum of squares): a dim sky hit a hundred times says nothing
    of a lamp that was hit twice.
    """
    total = np.float64(0.0)
    squared = np.float64(0.0)
    for q in range(4):
        total += np.float64(sums[node, q])
        squared += np.float64(squares[node, q])
    # Squares of very little are 0.
    count = total * total / squared if squared > 0.0 else np.float64(0.0)
    return np.float64(_PRIOR_RECORDS) / (np.float64(_PRIOR_RECORDS) + count)


@kernel
def collect_trees(first, last, is_variance_aware, totals, pool, values, areas, split, is_ready):
    """From what leaves have gathered, make the density of regions [first, last).

    A leaf's probability is in proportion to its energy; in a variance-aware tree to the root of its second moment times
    its area (`engine.guiding.fields.sdtree.model` derives it). Where a node has few records, its quadrants are more
    alike than these say: else light that none of them met would have no probability at all.

    Parameters
    ----------
    totals : float64 (R, TOTAL_WIDTH)
    pool : QuadPool, sums and squares of inner quadrants are written
    values : float64 (Q, 4), written: what the probability of each quadrant is in proportion to
    areas : float32 (Q,), scratch: share of the sphere of each node
    split : float32 (Q, SPLIT_WIDTH), written, see `SdTreeField`
    is_ready : uint8 (R,), written
    """
    child, sums, squares = pool.child, pool.sums, pool.squares
    for region in range(first, last):
        start = np.int64(pool.root[region])
        stop = np.int64(pool.root[region + 1])
        areas[start] = 1.0
        for node in range(start, stop):
            for q in range(4):
                if child[node, q] != QUAD_LEAF:
                    areas[start + np.int64(child[node, q])] = 0.25 * areas[node]
        for node in range(stop - 1, start - 1, -1):
            for q in range(4):
                below = np.int64(child[node, q])
                if below != QUAD_LEAF:
                    below += start
                    sums[node, q] = (sums[below, 0] + sums[below, 1]) + (sums[below, 2] + sums[below, 3])
                    squares[node, q] = (squares[below, 0] + squares[below, 1]) + (squares[below, 2] + squares[below, 3])
                    values[node, q] = (values[below, 0] + values[below, 1]) + (values[below, 2] + values[below, 3])
                elif is_variance_aware:
                    values[node, q] = math.sqrt(np.float64(sums[node, q]) * np.float64(0.25 * areas[node]))
                else:
                    values[node, q] = np.float64(sums[node, q])
        total = (values[start, 0] + values[start, 1]) + (values[start, 2] + values[start, 3])
        is_lit = total > _LEAST_SUM and totals[region, TOTAL_ENERGY] > _LEAST_SUM
        is_ready[region] = 1 if is_lit else 0
        for node in range(start, stop):
            whole = (values[node, 0] + values[node, 1]) + (values[node, 2] + values[node, 3])
            even = np.float64(1.0)
            if is_lit and whole > _LEAST_SUM:
                even = _even_share(sums, squares, node)
            learned = (1.0 - even) / max(whole, np.float64(_LEAST_SUM))
            even *= np.float64(0.25)
            lower = (values[node, 0] + values[node, 2]) * learned + 2.0 * even
            upper = (values[node, 1] + values[node, 3]) * learned + 2.0 * even
            split[node, SPLIT_PHI] = _split(lower, lower + upper)
            split[node, SPLIT_Z] = _split(values[node, 0] * learned + even, lower)
            split[node, SPLIT_Z + 1] = _split(values[node, 1] * learned + even, upper)


@kernel
def refine_tree(pool, values, region, flux_share, max_depth, scratch, refined, is_written):
    """Divide the quadrants of a region that hold much and join those that do not.

    Parameters
    ----------
    pool : QuadPool
    values : float64 (Q, 4), of `collect_trees`
    region : int
    flux_share : float
        Quadrants with more of the total are divided, down to `max_depth` divisions of the sphere.
    scratch : RefineScratch
    refined : QuadPool
        All of it but its root is written if `is_written`, else nothing, and `pool` will do; what a quadrant held is
        spread evenly over its new parts.

    Returns
    -------
    int, nodes of the new quadtree
    """
    child, sums, squares = pool.child, pool.sums, pool.squares
    new_child, new_sums, new_squares = refined.child, refined.sums, refined.squares
    links, quarters = scratch.links, scratch.quarters
    start = np.int64(pool.root[region])
    target = np.int64(refined.root[region])
    total = (values[start, 0] + values[start, 1]) + (values[start, 2] + values[start, 3])
    is_lit = total > _LEAST_SUM
    least = total * flux_share
    links[0, 0] = start
    links[0, 1] = 1
    count = 1
    node = 0
    while node < count:
        old = np.int64(links[node, 0])
        depth = np.int64(links[node, 1])
        for q in range(4):
            value = quarters[node, 0]
            held = quarters[node, 1]
            squared = quarters[node, 2]
            below = np.int64(-1)
            if old >= 0:
                value = values[old, q]
                held = np.float64(sums[old, q])
                squared = np.float64(squares[old, q])
                below = np.int64(child[old, q])
                below = start + below if below != QUAD_LEAF else np.int64(-1)
            # Without light the tree stays as it is.
            is_divided = value > least if is_lit else below >= 0
            is_divided = is_divided and depth < max_depth and count < MAX_NODES
            if is_written:
                new_child[target + node, q] = count if is_divided else QUAD_LEAF
                new_sums[target + node, q] = np.float32(held)
                new_squares[target + node, q] = np.float32(squared)
            if is_divided:
                links[count, 0] = below
                links[count, 1] = depth + 1
                quarters[count, 0] = 0.25 * value
                quarters[count, 1] = 0.25 * held
                quarters[count, 2] = 0.25 * squared
                count += 1
        node += 1
    return count


@kernel
def count_refined(first, last, pool, values, flux_share, max_depth, scratch, node_counts):
    """Write how many nodes the refined quadtrees of regions [first, last) have: int32 (R,), see `refine_tree`."""
    for region in range(first, last):
        node_counts[region] = refine_tree(pool, values, region, flux_share, max_depth, scratch, pool, False)


@kernel
def write_refined(first, last, pool, values, flux_share, max_depth, scratch, refined):
    """Write the refined quadtrees of regions [first, last), see `refine_tree`."""
    for region in range(first, last):
        refine_tree(pool, values, region, flux_share, max_depth, scratch, refined, True)
