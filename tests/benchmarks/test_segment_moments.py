# SPDX-License-Identifier: GPL-3.0-or-later
"""What guiding where paths collide could bring: segments found in records, and closed forms of what is left."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.segment_moments import (
    Segments,
    blocks_of_picture,
    camera_segments,
    cells_of_space,
    later_segments,
    moment_left,
)
from engine.guiding.records.vertices import allocate_vertex_records

ALONG = np.array((0.0, 0.6, 0.8), np.float32)


def made(collided, found, length=None):
    """Segments from one place in one direction."""
    count = len(collided)
    return Segments(
        np.zeros((count, 3), np.float32), np.tile(ALONG, (count, 1)),
        np.ones(count, np.float32) if length is None else length.astype(np.float32), collided,
        np.asarray(found, np.float32),
    )  # fmt: skip


def one_cell(segments):
    return np.zeros(len(segments.length), np.int64)


def test_what_is_left_is_the_closed_form():
    collided = np.arange(20_000) % 2 == 0
    segments = made(collided, np.where(collided, 3.0, 1.0))
    # Half of the time 9, half of the time 1; the choice 3 : 1, a fifth of which stays even.
    q = 0.8 * 0.75 + 0.2 * 0.5
    expected = (0.25 * 9.0 / q + 0.25 * 1.0 / (1.0 - q)) / 5.0
    assert moment_left(segments, one_cell(segments)) == pytest.approx(expected, abs=0.01)


def test_where_all_ends_bring_the_same_nothing_is_gained():
    rng = np.random.default_rng(1)
    collided = rng.random(20_000) < 0.3
    segments = made(collided, rng.exponential(size=20_000))
    assert moment_left(segments, one_cell(segments)) == pytest.approx(1.0, abs=0.01)
    # Nor is anything lost by nothing but luck where cells are many and segments few: it is seen as a loss.
    cells = rng.integers(0, 2000, 20_000)
    assert moment_left(segments, cells) > 1.0


def test_cells_that_differ_are_guided_apart():
    collided = np.arange(40_000) % 2 == 0
    cells = np.arange(40_000) // 20_000
    segments = made(collided, np.where(collided == (cells == 0), 3.0, 1.0))
    assert moment_left(segments, one_cell(segments)) == pytest.approx(1.0, abs=0.01)
    assert moment_left(segments, cells) < 0.85


def test_distances_are_told_apart():
    rng = np.random.default_rng(2)
    length = rng.random(40_000)
    collided = np.ones(40_000, np.bool_)
    segments = made(collided, np.where(length < 0.25, 4.0, 0.1), length)
    assert moment_left(segments, one_cell(segments)) == pytest.approx(1.0)
    # One in four brings all: half of the second moment by sqrt, with a fifth of the choice left even.
    assert moment_left(segments, one_cell(segments), 4) < 0.4


def path_records():
    """A path from a camera at the origin: a collision after 2 m, another 1 m on, then a surface 3 m on."""
    records = allocate_vertex_records(5)
    turn = np.array((1.0, 0.0, 0.0), np.float32)
    places = np.array([2.0 * ALONG, 2.0 * ALONG + turn, 2.0 * ALONG + 4.0 * turn], np.float32)
    # From the last vertex to the first; then a path of which only the first vertex was recorded.
    records.position[:4] = [places[2], places[1], places[0], 7.0 * ALONG]
    records.wo[:4] = [-turn, -turn, -ALONG, -ALONG]
    records.direction[:4] = [(0.0, 0.0, 1.0), turn, turn, (0.0, 0.0, 1.0)]
    records.cost[:4] = [1.0, 2.0, 3.0, 4.0]
    records.light_squared[:4] = [4.0, np.nan, np.nan, 0.0]
    records.contribution_squared[:4] = [1.0, 9.0, 16.0, 25.0]
    return records


def test_segments_are_found_in_records():
    later = later_segments(path_records(), 4)
    # The fourth is one more scattering before the end than the third, and yet of another path.
    np.testing.assert_allclose(later.length, [3.0, 1.0], rtol=1e-5)
    assert later.collided.tolist() == [False, True]
    # On a surface its light sample counts.
    assert later.found.tolist() == [3.0, 3.0]
    seen = camera_segments(path_records(), 4, np.zeros(3, np.float32))
    np.testing.assert_allclose(seen.length, [2.0, 7.0], rtol=1e-5)
    assert seen.collided.tolist() == [True, False] and seen.found.tolist() == [4.0, 5.0]
    # Not from elsewhere.
    assert len(camera_segments(path_records(), 4, np.array((9.0, 0.0, 0.0), np.float32)).length) == 0


def test_cells_part_what_begins_and_goes_elsewhere():
    rng = np.random.default_rng(3)
    count = 4000
    direction = rng.normal(size=(count, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    segments = Segments(
        rng.random((count, 3)).astype(np.float32), direction.astype(np.float32), np.ones(count, np.float32),
        np.zeros(count, np.bool_), np.ones(count, np.float32),
    )  # fmt: skip
    assert len(np.unique(cells_of_space(segments, 0))) == 8
    assert len(np.unique(cells_of_space(segments, 2))) == 32
    ahead = segments._replace(direction=np.column_stack((direction[:, :2] * 0.1, np.ones(count))).astype(np.float32))
    assert 12 <= len(np.unique(blocks_of_picture(ahead, 4))) <= 16
