# SPDX-License-Identifier: GPL-3.0-or-later
"""Handing pieces of a field's update to threads."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

import numpy as np

from engine.scene.arrays import Int64Array

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


def balance(sizes: Int64Array, piece_count: int) -> Int64Array:
    """Borders between runs of consecutive items of about the same total size: int64 (pieces + 1,)."""
    ends = np.cumsum(sizes)
    wanted = np.linspace(0.0, float(ends[-1]), piece_count + 1)[1:-1]
    inner = np.searchsorted(ends, wanted, side="left") + 1
    return np.unique(np.concatenate([[0], np.minimum(inner, sizes.size), [sizes.size]]).astype(np.int64))
