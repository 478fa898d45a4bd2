# SPDX-License-Identifier: GPL-3.0-or-later
"""The records that training draws from: those of the last samples per pixel, oldest out first."""

from __future__ import annotations

from collections import deque

import numpy as np

from engine.array_types import Float32Array, Int64Array


class SampleWindow:
    """A ring of rows.

    Parameters
    ----------
    capacity : int
        Rows at most.
    row_width : int
    window_samples : float
        Samples a pixel that the rows kept may stem from; the last submission stays whatever its length.
    """

    def __init__(self, capacity: int, row_width: int, window_samples: float) -> None:
        self.rows = np.zeros((capacity, row_width), np.float32)
        self.window_samples = window_samples
        self.count = 0
        self._start = 0
        #: Rows held of each submission, oldest first, and its samples a pixel.
        self._segments: deque[tuple[int, float]] = deque()

    def add(self, rows: Float32Array, samples: float) -> None:
        """Append rows from `samples` samples a pixel; make room for them."""
        capacity = self.rows.shape[0]
        rows = rows[-capacity:]
        while self._segments and sum(s for _, s in self._segments) + samples > self.window_samples:
            self._drop(self._segments[0][0])
            self._segments.popleft()
        self._drop(max(0, self.count + rows.shape[0] - capacity))
        self._segments.append((rows.shape[0], samples))
        end = (self._start + self.count) % capacity
        head = min(rows.shape[0], capacity - end)
        self.rows[end : end + head] = rows[:head]
        self.rows[: rows.shape[0] - head] = rows[head:]
        self.count += rows.shape[0]

    def keep(self, is_kept: np.ndarray) -> None:
        """Keep these rows only: bool (count,), by age. Later rows push the oldest of them out as if all were left."""
        rows = self.take(np.flatnonzero(is_kept))
        edges = np.cumsum([0, *(count for count, _ in self._segments)])
        counts = np.diff(np.cumsum([0, *is_kept])[edges])
        self._segments = deque(
            (int(count), samples) for count, (_, samples) in zip(counts, self._segments, strict=True) if count
        )
        self._start, self.count = 0, rows.shape[0]
        self.rows[: rows.shape[0]] = rows

    def _drop(self, row_count: int) -> None:
        """Drop the oldest rows, and take them off the segments they came in."""
        self._start = (self._start + row_count) % self.rows.shape[0]
        self.count -= row_count
        left = row_count
        for index, (held, samples) in enumerate(self._segments):
            self._segments[index] = (max(0, held - left), samples)
            left = max(0, left - held)

    def take(self, picks: Int64Array) -> Float32Array:
        """Rows by age: 0 is the oldest."""
        return np.take(self.rows, (self._start + picks) % self.rows.shape[0], axis=0)
