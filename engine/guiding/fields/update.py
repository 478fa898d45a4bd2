# SPDX-License-Identifier: GPL-3.0-or-later
"""What updates of fields share: handing pieces to threads, and carrying over what regions knew that are cut."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

import numpy as np

from engine.array_types import Int32Array, Int64Array

Runner = Callable[[Callable[[int], None], int], None]


def make_runner(executor: ThreadPoolExecutor | None, thread_count: int) -> Runner:
    """A function that runs work items 0 to count - 1, in this thread or on the executor's."""

    def run(work: Callable[[int], None], count: int) -> None:
        if executor is None or thread_count < 2 or count < 2:
            for item in range(count):
                work(item)
            return
        for _done in executor.map(work, range(count)):
            pass

    return run


def inherit(sums: np.ndarray, split_log: Int32Array, region_count: int, share: float) -> np.ndarray:
    """Sums by region, carried over an update that cut regions.

    Parameters
    ----------
    sums : array (R, ...), of the regions before the update
    split_log : int32 (S, 2), new region and its parent, in the order of the cuts
    region_count : int, after the update
    share : float, what a region that was cut passes to each of its halves

    Returns
    -------
    array (region_count, ...), of the same type
    """
    carried = np.zeros((region_count, *sums.shape[1:]), sums.dtype)
    carried[: len(sums)] = sums
    for region, parent in split_log:
        carried[parent] *= share
        carried[region] = carried[parent]
    return carried


def balance(sizes: Int64Array, piece_count: int) -> Int64Array:
    """Borders between runs of consecutive items of about the same total size: int64 (pieces + 1,)."""
    ends = np.cumsum(sizes)
    wanted = np.linspace(0.0, float(ends[-1]), piece_count + 1)[1:-1]
    inner = np.searchsorted(ends, wanted, side="left") + 1
    return np.unique(np.concatenate([[0], np.minimum(inner, sizes.size), [sizes.size]]).astype(np.int64))
