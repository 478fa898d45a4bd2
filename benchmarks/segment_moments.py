# SPDX-License-Identifier: GPL-3.0-or-later
"""What guiding whether and where paths collide with media could bring at most, from what a render has recorded.

A segment of a path ends in a collision, or passes on to a surface. Let Y be what the path finds from there on, P the
probability of a collision, and m the mean of Y squared behind either end. Drawing the end with the probability Q
instead leaves Y's mean as it is. Its second moment becomes P^2 m_collided / Q + (1 - P)^2 m_passed / (1 - Q), which is
least where Q is in proportion to P sqrt(m). Distances are guided likewise, by intervals of them in place of the two
ends.

References
----------
Xu et al. 2024, "Volume Scattering Probability Guiding": the choice by second moments.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from engine.array_types import Float32Array, Int64Array
from engine.guiding.records.vertices import VertexRecords

BoolArray = npt.NDArray[np.bool_]
Float64Array = npt.NDArray[np.float64]

#: Cosine from which two vertices are taken to lie on one line.
_ALONG = 0.9999
#: Share of the probability that stays what it was, in every cell.
_DEFENSIVE_SHARE = 0.2
#: Records for which the mean of a cell counts in each of its intervals.
_PRIOR_COUNT = 8.0
#: Quantile beyond which contributions are cut off.
_CUT = 0.9995
#: Records below which a cell of space is not split.
_LEAST_SPLIT = 800


class Segments(NamedTuple):
    """Segments of paths that have ended in a collision or at a surface.

    origin : float32 (N, 3) [m]
    direction : float32 (N, 3), unit
    length : float32 (N,) [m], to where they ended
    collided : bool (N,)
    found : float32 (N,), what the path has found behind the end, over its pixel's value
    """

    origin: Float32Array
    direction: Float32Array
    length: Float32Array
    collided: BoolArray
    found: Float32Array


def _ends(records: VertexRecords, rows: Int64Array) -> tuple[BoolArray, Float32Array]:
    """Which vertices are collisions, and what paths have found from these on, their own light sample included."""
    light = records.light_squared[rows]
    collided = np.isnan(light)
    behind = np.sqrt(np.maximum(records.contribution_squared[rows], 0.0))
    sampled = np.sqrt(np.maximum(np.where(collided, 0.0, light), 0.0))
    return collided, (behind + sampled).astype(np.float32)


def _follows(records: VertexRecords, row_count: int) -> BoolArray:
    """For every row but the first: whether the row before it is the next vertex of the same path, bool (R - 1,)."""
    # Paths are recorded from their last vertex to their first.
    cost, rows = records.cost[:row_count], np.arange(1, row_count)
    along = -(records.wo[rows - 1] * records.direction[rows]).sum(axis=1)
    return np.asarray((cost[rows - 1] == cost[rows] - 1.0) & (along > _ALONG))


def later_segments(records: VertexRecords, row_count: int) -> Segments:
    """Segments between two recorded vertices; light that lies at the far end itself is not in `found`."""
    position = records.position
    rows = 1 + np.flatnonzero(_follows(records, row_count))
    collided, found = _ends(records, rows - 1)
    length = np.linalg.norm(position[rows - 1] - position[rows], axis=1)
    return Segments(position[rows], -records.wo[rows - 1], length.astype(np.float32), collided, found)


def camera_segments(records: VertexRecords, row_count: int, camera: Float32Array) -> Segments:
    """Segments from a camera, whose place [m] is float32 (3,), to the first vertex of a path."""
    is_first = np.ones(row_count, np.bool_)
    is_first[:-1] = ~_follows(records, row_count)
    offset = records.position[:row_count] - camera
    length = np.linalg.norm(offset, axis=1)
    # Rays that something has bent on their way are left out.
    seen = (-records.wo[:row_count] * offset).sum(axis=1) > _ALONG * np.maximum(length, 1e-6)
    rows = np.flatnonzero(is_first & seen)
    collided, found = _ends(records, rows)
    origin = np.broadcast_to(camera.astype(np.float32), (len(rows), 3))
    return Segments(origin, -records.wo[rows], length[rows].astype(np.float32), collided, found)


def cells_of_space(segments: Segments, depth: int) -> Int64Array:
    """Cells by where segments begin, halved `depth` times along the longest side, and the eight octants of directions.

    Returns
    -------
    int64 (N,)
    """
    cells = np.zeros(len(segments.length), np.int64)
    open_rows = [np.arange(len(cells))]
    for _ in range(depth):
        halves = []
        for rows in open_rows:
            if len(rows) < _LEAST_SPLIT:
                halves.append(rows)
                continue
            axis = int(np.ptp(segments.origin[rows], axis=0).argmax())
            order = rows[np.argsort(segments.origin[rows, axis], kind="stable")]
            halves += [order[: len(order) // 2], order[len(order) // 2 :]]
        open_rows = halves
    for number, rows in enumerate(open_rows):
        cells[rows] = number
    octant = (segments.direction > 0.0) @ np.array((1, 2, 4))
    return cells * 8 + octant


def blocks_of_picture(segments: Segments, side: int) -> Int64Array:
    """Cells by direction: `side` x `side` blocks of what a camera sees, int64 (N,)."""
    axis = segments.direction.mean(axis=0, dtype=np.float64)
    axis /= np.linalg.norm(axis)
    across = np.cross(axis, (0.0, 0.0, 1.0) if abs(axis[2]) < 0.99 else (1.0, 0.0, 0.0))
    across /= np.linalg.norm(across)
    blocks = np.zeros(len(segments.length), np.int64)
    for along in (across, np.cross(axis, across)):
        place = (segments.direction @ along) / np.maximum(segments.direction @ axis, 1e-3)
        low, high = np.quantile(place, (0.001, 0.999))
        step = np.clip((place - low) / max(high - low, 1e-9) * side, 0, side - 1)
        blocks = blocks * side + step.astype(np.int64)
    return blocks


def cut(found: Float32Array) -> Float64Array:
    """What segments have found, cut off where a handful of records would decide."""
    values = found.astype(np.float64)
    return np.asarray(np.minimum(values, np.quantile(values, _CUT)))


def _moments(ends: Int64Array, found: Float64Array, shape: tuple[int, int]) -> tuple[Float64Array, Float64Array]:
    """How many segments have each end in each cell, and their sums of squares."""
    size = shape[0] * shape[1]
    count = np.bincount(ends, minlength=size).reshape(shape).astype(np.float64)
    return count, np.bincount(ends, found * found, minlength=size).reshape(shape)


def moment_left(segments: Segments, cells: Int64Array, interval_count: int = 1, seed: int = 0) -> float:
    """Second moment of what is found with the best choice of ends in each cell, over what it is.

    The choice is made by one half of the segments and judged by the other, both ways. More than 1: learning by so few
    would do harm.

    Parameters
    ----------
    cells : int64 (N,), from 0 on
    interval_count : int
        1: collide or pass. More: in which interval of distances, by quantiles of those of all collisions.
    """
    found = cut(segments.found)
    interval = segments.collided.astype(np.int64)
    if interval_count > 1 and segments.collided.any():
        limits = np.quantile(segments.length[segments.collided], np.arange(1, interval_count) / interval_count)
        interval *= 1 + np.searchsorted(limits, segments.length)
    shape = (int(cells.max()) + 1, interval_count + 1)
    ends = cells * shape[1] + interval
    is_half = np.random.default_rng(seed).random(len(found)) < 0.5
    left = []
    for known, judged in ((is_half, ~is_half), (~is_half, is_half)):
        count, squares = _moments(ends[known], found[known], shape)
        of_cell = count.sum(axis=1, keepdims=True)
        probability = count / np.maximum(of_cell, 1.0)
        mean = (squares + _PRIOR_COUNT * squares.sum(axis=1, keepdims=True) / np.maximum(of_cell, 1.0)) / (
            count + _PRIOR_COUNT
        )
        chosen = probability * np.sqrt(mean)
        total = chosen.sum(axis=1, keepdims=True)
        chosen = np.where(total > 0.0, chosen / np.where(total > 0.0, total, 1.0), probability)
        chosen = (1.0 - _DEFENSIVE_SHARE) * chosen + _DEFENSIVE_SHARE * probability
        # What was never met stays as likely as it was.
        ratio = np.divide(probability, chosen, out=np.ones(shape), where=chosen > 0.0)
        _, squares = _moments(ends[judged], found[judged], shape)
        left.append(float((squares * ratio).sum() / squares.sum()))
    return float(np.mean(left))
