# SPDX-License-Identifier: GPL-3.0-or-later
"""Puts the workers' sums on the film: each range once, those of a part in the order of their samples."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from engine.cluster.ranges import Region, SampleRange
from engine.render.film import Film
from engine.state.film import FilmTile


class Collector:
    """The film of a frame that comes in ranges.

    A range that comes before its predecessors waits: float32 sums depend on the order in which they are added up.

    Parameters
    ----------
    film : Film
        Of the region.
    region : (x0, y0, x1, y1)
        In pixels of the full image.
    ranges : sequence of SampleRange
        By number.

    Attributes
    ----------
    path_count : int
        Paths whose sums have come.
    """

    def __init__(self, film: Film, region: Region, ranges: Sequence[SampleRange]) -> None:
        self.path_count = 0
        self._film = film
        self._region = region
        self._ranges = ranges
        self._come: set[int] = set()
        self._waiting: dict[tuple[int, int], FilmTile] = {}
        self._next_steps: dict[int, int] = {}

    @property
    def is_complete(self) -> bool:
        """Whether all ranges have come."""
        return len(self._come) == len(self._ranges)

    @property
    def has_paths(self) -> bool:
        """Whether there is anything on the film."""
        return bool(self._next_steps)

    def has(self, number: int) -> bool:
        """Whether this range has come."""
        return number in self._come

    def take(self, number: int, sums: FilmTile) -> bool:
        """Add a range's sums; False if they had come before, and do not count."""
        if number in self._come:
            return False
        item = self._ranges[number]
        self._come.add(number)
        self.path_count += item.path_count
        self._waiting[item.part, item.step] = sums
        step = self._next_steps.get(item.part, 0)
        while (found := self._waiting.pop((item.part, step), None)) is not None:
            self._film.merge(self._film_index(item.region), found)
            step += 1
            self._next_steps[item.part] = step
        return True

    def flush(self) -> None:
        """Add what waits for predecessors that will not come, of a render that ends early."""
        regions = {item.part: item.region for item in self._ranges}
        for part, step in sorted(self._waiting):
            self._film.merge(self._film_index(regions[part]), self._waiting[part, step])
            self._next_steps[part] = step + 1
        self._waiting = {}

    def _film_index(self, region: Region) -> np.ndarray:
        """Where a part's pixels are on the film: int64 (P,)."""
        x0, y0, _, _ = self._region
        left, bottom, right, top = region
        rows = np.arange(bottom - y0, top - y0, dtype=np.int64)[:, None] * self._film.width
        return (rows + np.arange(left - x0, right - x0, dtype=np.int64)).reshape(-1)
