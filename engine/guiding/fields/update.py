# SPDX-License-Identifier: GPL-3.0-or-later
"""What updates of fields share: work for threads, sorting records by region, carrying over what cut regions knew."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from engine.array_types import Int32Array, Int64Array

Runner = Callable[[Callable[[int], None], int], None]

#: Records are sorted in chunks of this many, whatever the number of threads.
_CHUNK = 16384
#: Work is handed out in pieces: this many a thread, so that none waits long for another.
PIECES_PER_THREAD = 4

# What became of a record that is left out, columns of counts by chunk.
REJECT_NOT_FINITE = 0
REJECT_OUTSIDE = 1
REJECT_WIDTH = 2


@dataclass
class UpdateReport:
    """Totals since a model was made."""

    update_count: int = 0
    record_count: int = 0
    #: Records left out: not finite or of impossible density or direction; outside the bounds.
    invalid_count: int = 0
    outside_count: int = 0
    #: Regions that began anew, since what they had learned was no density.
    unsound_count: int = 0
    seconds: float = 0.0

    def count_rejects(self, rejects: Int64Array) -> None:
        """Add counts by chunk, int64 (chunks, REJECT_WIDTH)."""
        self.invalid_count += int(rejects[:, REJECT_NOT_FINITE].sum())
        self.outside_count += int(rejects[:, REJECT_OUTSIDE].sum())

    def figures(self) -> dict[str, float]:
        """For the render's report."""
        return {
            "updates": self.update_count,
            "records": self.record_count,
            "records_invalid": self.invalid_count,
            "records_outside": self.outside_count,
            "regions_unsound": self.unsound_count,
            "seconds": self.seconds,
        }


def padded_bounds(bounds: npt.ArrayLike) -> npt.NDArray[np.float64]:
    """Bounds (2, 3) of a field with a little margin: float64.

    Raises
    ------
    ValueError
        If they are not finite, or the first corner is above the second along any axis.
    """
    corners = np.asarray(bounds, np.float64).reshape(2, 3)
    if not np.isfinite(corners).all() or (corners[0] > corners[1]).any():
        raise ValueError(f"field bounds must be finite and ordered, not {corners.tolist()}")
    margin = 1e-3 * max(float((corners[1] - corners[0]).max()), 1e-3) + 1e-5 * np.abs(corners).max(0)
    return np.stack([corners[0] - margin, corners[1] + margin])


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


def chunk_count(row_count: int) -> int:
    """Chunks that so many records are sorted in, at least one."""
    return max(-(-row_count // _CHUNK), 1)


def run_chunks(run: Runner, row_count: int, work: Callable[[int, int, int], None]) -> None:
    """Call work(start, stop, chunk) for the rows of every chunk."""
    run(
        lambda chunk: work(chunk * _CHUNK, min((chunk + 1) * _CHUNK, row_count), chunk),
        chunk_count(row_count),
    )


def places_by_region(counts: Int32Array) -> tuple[Int64Array, Int64Array]:
    """Where records go that are sorted by region, and within a region by chunk.

    Parameters
    ----------
    counts : int32 (chunks, regions)

    Returns
    -------
    int64 (chunks, regions), place of the first record of a chunk in a region; int64 (regions, 2), each region's rows
    """
    by_region = counts.astype(np.int64)
    ends = np.cumsum(by_region.sum(0))
    starts = ends - by_region.sum(0)
    offsets = np.ascontiguousarray(starts + np.cumsum(by_region, 0) - by_region)
    return offsets, np.ascontiguousarray(np.stack([starts, ends], 1))


def grown(array: np.ndarray, rows: int) -> np.ndarray:
    """A copy with room for so many rows, zeros behind those that there are."""
    larger = np.zeros((rows, *array.shape[1:]), array.dtype)
    larger[: array.shape[0]] = array
    return larger


def log_splits(parents: Int32Array, old_count: int, region_count: int) -> Int32Array:
    """Regions from the old count on, and the region that each was cut from, in order: int32 (S, 2)."""
    made = np.arange(old_count, region_count, dtype=np.int32)
    return np.ascontiguousarray(np.stack([made, parents[old_count:region_count]], 1))


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
    carried = grown(sums, region_count)
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
