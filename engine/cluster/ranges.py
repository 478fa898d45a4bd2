# SPDX-License-Identifier: GPL-3.0-or-later
"""How a frame is divided: parts of the picture by ranges of samples.

Both follow what one machine's threads do (`engine.render.schedule.sample_ranges`, `engine.render.tiles`): a part
is made of whole tiles, and a range is one of a tile's successive tasks. So each float32 sum is added up in the same
order as on one machine, and the picture is the same to the last bit.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

from engine.render.schedule import sample_ranges
from engine.render.tiles import TILE_SIZE
from engine.scene.description import Frame

Region = tuple[int, int, int, int]


@dataclass(frozen=True)
class SampleRange:
    """What a worker renders at a time.

    number : int, of all ranges of a render: whoever brings the same number brings the same sums
    part, step : int, which part of the picture, and which of its successive ranges
    region : (x0, y0, x1, y1) in pixels of the full image
    first, count : int, samples
    """

    number: int
    part: int
    step: int
    region: Region
    first: int
    count: int

    @property
    def path_count(self) -> int:
        """Paths that it takes."""
        x0, y0, x1, y1 = self.region
        return (x1 - x0) * (y1 - y0) * self.count


def plan_ranges(frame: Frame, samples: int, part_count: int) -> list[SampleRange]:
    """All ranges of a render: the first of every part, then the second of every part, and so on.

    Parameters
    ----------
    part_count : int
        Parts that are wanted; there are not more than tiles.
    """
    regions = list(_regions(frame.region, part_count))
    steps = sample_ranges(samples)
    return [
        SampleRange(step * len(regions) + part, part, step, region, *steps[step])
        for step in range(len(steps))
        for part, region in enumerate(regions)
    ]


def _regions(region: Region, count: int) -> Iterator[Region]:
    """Rectangles of whole tiles that fill the region: rows first, then columns where there are too few rows."""
    x0, y0, x1, y1 = region
    row_count, column_count = -(-(y1 - y0) // TILE_SIZE), -(-(x1 - x0) // TILE_SIZE)
    if not row_count or not column_count:
        return
    rows = max(min(row_count, count), 1)
    columns = max(min(column_count, -(-count // rows)), 1)
    for bottom, top in _cuts(y0, y1, row_count, rows):
        for left, right in _cuts(x0, x1, column_count, columns):
            yield left, bottom, right, top


def _cuts(start: int, end: int, tile_count: int, count: int) -> Iterator[tuple[int, int]]:
    """`tile_count` tiles from `start` on in `count` pieces of about the same size; the last tile may be smaller."""
    edges = [start + tile_count * piece // count * TILE_SIZE for piece in range(count)] + [end]
    yield from pairwise(edges)
