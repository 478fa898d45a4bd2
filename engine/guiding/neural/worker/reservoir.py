# SPDX-License-Identifier: GPL-3.0-or-later
"""The rows that training draws from: as even a sample of all that came as there is room for."""

from __future__ import annotations

import numpy as np

from engine.array_types import Float32Array, Int64Array


class RowReservoir:
    """Rows, each of all that came held with the same probability.

    Parameters
    ----------
    capacity : int
        Rows at most.
    row_width : int
    random : numpy.random.Generator

    References
    ----------
    Vitter 1985, "Random Sampling with a Reservoir" (here for rows that come in batches).
    """

    def __init__(self, capacity: int, row_width: int, random: np.random.Generator) -> None:
        self.rows = np.zeros((capacity, row_width), np.float32)
        self.count = 0
        #: Grows whenever rows change.
        self.version = 0
        self._random = random
        #: Rows that those held stand for.
        self._seen = 0

    def add(self, rows: Float32Array) -> None:
        """Take rows, or as large a share of them as is held of the rows before them."""
        self.version += 1
        capacity = self.rows.shape[0]
        self._seen += rows.shape[0]
        if self._seen <= capacity:
            self._place(rows, np.arange(self.count, self.count + rows.shape[0]))
            return
        taken = int(capacity * rows.shape[0] / self._seen + self._random.random())
        taken = min(taken, rows.shape[0])
        leaving = max(self.count + taken - capacity, 0)
        places = np.concatenate((
            self._random.choice(self.count, leaving, replace=False),
            np.arange(self.count, self.count + taken - leaving),
        ))  # fmt: skip
        self._place(rows[self._random.choice(rows.shape[0], taken, replace=False)], places)

    def keep(self, is_kept: np.ndarray) -> None:
        """Keep these rows only, bool (count,), as if they were all that came."""
        self.version += 1
        rows = self.rows[: self.count][is_kept]
        self.count = self._seen = rows.shape[0]
        self.rows[: self.count] = rows

    def _place(self, rows: Float32Array, places: Int64Array) -> None:
        self.rows[places] = rows
        self.count = max(self.count, int(places.max(initial=-1)) + 1)

    def take(self, picks: Int64Array) -> Float32Array:
        """Rows by number, in [0, count)."""
        return np.take(self.rows, picks, axis=0)
