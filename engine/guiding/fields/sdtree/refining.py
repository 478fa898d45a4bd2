# SPDX-License-Identifier: GPL-3.0-or-later
"""Quadtrees that gather next: refined from those that have gathered, over threads."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from engine.array_types import Int32Array, Int64Array
from engine.guiding.fields.sdtree import quadtree
from engine.guiding.fields.sdtree.quadtree import QuadPool
from engine.guiding.fields.update import Runner


def empty_pool(root: Int32Array) -> QuadPool:
    """Room for quadtrees of given nodes."""
    shape = (int(root[-1]), 4)
    return QuadPool(root, np.empty(shape, np.int32), np.empty(shape, np.float32), np.empty(shape, np.float32))


def refine(
    pool: QuadPool, values: npt.NDArray[np.float64], flux_share: float, max_depth: int, run: Runner, pieces: Int64Array
) -> QuadPool:
    """The pool that gathers next.

    Parameters
    ----------
    pool : QuadPool
        What has gathered.
    values : float64 (N, 4)
        Energy of its quadrants.
    flux_share : float
        Quadrants with more than this share of their tree's energy are divided.
    max_depth : int
    run : Runner
    pieces : int64 (P + 1,)
        First tree of each piece of work, and the number of trees.
    """
    counts = np.zeros(len(pool.root) - 1, np.int32)

    def count(piece: int) -> None:
        quadtree.count_refined(
            int(pieces[piece]), int(pieces[piece + 1]), pool, values, flux_share, max_depth,
            quadtree.allocate_refine_scratch(), counts,
        )

    run(count, pieces.size - 1)
    refined = empty_pool(np.concatenate([[0], np.cumsum(counts)]).astype(np.int32))

    def write(piece: int) -> None:
        quadtree.write_refined(
            int(pieces[piece]), int(pieces[piece + 1]), pool, values, flux_share, max_depth,
            quadtree.allocate_refine_scratch(), refined,
        )

    run(write, pieces.size - 1)
    return refined
