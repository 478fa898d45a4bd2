# SPDX-License-Identifier: GPL-3.0-or-later
"""Cells of the radiance cache: found again where they were made, apart by side and size, right on average."""

import numpy as np
import pytest

from engine.guiding.fields.cells.field import (
    LEVEL_COUNT,
    SUM_COUNT,
    SUM_WEIGHT,
    cell_key,
    cell_size,
    empty_cells,
    find_cell,
    no_cells,
)
from engine.guiding.fields.cells.model import CellModel
from engine.guiding.records.cache_records import allocate_cache_records
from engine.runtime.jit import kernel

UP, DOWN = (0.0, 0.0, 1.0), (0.0, 0.0, -1.0)


@kernel
def _find(cells, points, normal, program, level, out):
    for row in range(points.shape[0]):
        p = points[row, 0], points[row, 1], points[row, 2]
        place, tag = cell_key(cells, p, (normal[0], normal[1], normal[2]), program, level)
        out[row] = find_cell(cells, place, tag)


@kernel
def _size(cells, level):
    return cell_size(cells, level)


def find(cells, points, normal, level, program=0):
    """Places in the table of the cells at points (N, 3), -1 where there is none."""
    out = np.zeros(len(points), np.int64)
    _find(cells, np.asarray(points, np.float32), np.asarray(normal, np.float32), program, level, out)
    return out


#: Side of a footprint whose path asks cells of one level first, over the side of the smallest cells.
ASKS = tuple(8.0 * 1.1 * 2.0**level for level in range(LEVEL_COUNT))


def records(position, normal, radiance, side, program=0, weight=1.0):
    rows = allocate_cache_records(len(position))
    rows.weight[:], rows.side[:] = weight, side
    rows.position[:], rows.normal[:], rows.radiance[:], rows.program[:] = position, normal, radiance, program
    return rows


@pytest.fixture
def rng():
    return np.random.default_rng(7)


def test_a_cell_is_the_mean_of_what_was_sent_back_weighed_by_what_paths_bring_of_it(rng):
    count = 4000
    position = np.column_stack([rng.random((count, 2)) * 0.9e-3, np.zeros(count)]).astype(np.float32)
    position[0], position[-1] = (-1.0, -1.0, 0.0), (1.0, 1.0, 0.0)
    radiance = rng.gamma(0.5, 2.0, (count, 3)).astype(np.float32)
    model = CellModel()
    model.field = empty_cells(1e-3)
    weight = rng.random((count, 3)).astype(np.float32)
    model.learn(records(position, UP, radiance, 1e-3 * ASKS[0], weight=weight))
    slot = find(model.field, [(1e-4, 1e-4, 0.0)], UP, 0)[0]
    assert slot >= 0
    sums = model.field.sums[slot]
    assert sums[SUM_COUNT] == count - 2
    expected = (weight[1:-1] * radiance[1:-1]).sum(axis=0) / weight[1:-1].sum(axis=0)
    np.testing.assert_allclose(sums[:3] / sums[SUM_WEIGHT : SUM_WEIGHT + 3], expected, rtol=1e-4)


def test_sides_of_a_wall_walls_of_a_corner_and_materials_are_apart():
    position = np.zeros((64, 3), np.float32)
    model = CellModel()
    model.field = empty_cells(0.1)
    kinds = ((UP, 0, 1.0), (DOWN, 0, 2.0), ((1.0, 0.0, 0.0), 0, 3.0), (UP, 1, 4.0), (DOWN, 7, 5.0))
    for normal, program, value in kinds:
        model.learn(records(position, normal, value, 0.1 * ASKS[0], program))
    for normal, program, value in kinds:
        slot = find(model.field, [(0.0, 0.0, 0.0)], normal, 0, program)[0]
        assert slot >= 0
        sums = model.field.sums[slot]
        np.testing.assert_allclose(sums[:3] / sums[SUM_WEIGHT : SUM_WEIGHT + 3], value)


def known(model, point, level):
    """What the cell of a level says there (red), and of how many records; None and 0 where there is none."""
    slot = find(model.field, [point], UP, level)[0]
    if slot < 0:
        return None, 0
    sums = model.field.sums[slot]
    return sums[0] / sums[SUM_WEIGHT], sums[SUM_COUNT]


def test_larger_cells_hold_what_smaller_ones_hold():
    model = CellModel()
    model.field = empty_cells(1.0)
    near, far = np.full((4, 3), 0.5, np.float32), np.full((40, 3), 1.5, np.float32)
    near[:, 2] = far[:, 2] = 0.0
    for points in (near, far):
        model.learn(records(points, UP, 1.0, ASKS[0]))
    counts = [[known(model, points[0], level)[1] for level in range(LEVEL_COUNT)] for points in (near, far)]
    assert counts == [[4] + 5 * [44], [40] + 5 * [44]]
    assert [_size(model.field, level) for level in range(LEVEL_COUNT)] == [1, 2, 4, 8, 16, 32]
    assert find(model.field, [(1e4, 0.0, 0.0)], UP, 0)[0] == -1


def test_paths_from_close_by_hardly_speak_for_paths_from_afar():
    """The first come to the dark edge of a cell that they never ask: they count where nothing better is known."""
    model = CellModel()
    model.field = empty_cells(1.0)
    point = np.array([[0.5, 0.5, 0.0]], np.float32)
    model.learn(records(np.repeat(point, 100, axis=0), UP, 0.0, ASKS[0]))
    assert known(model, point[0], 5) == (0.0, 100)
    model.learn(records(np.repeat(point, 100, axis=0), UP, 1.0, ASKS[3]))
    said = [known(model, point[0], level)[0] for level in range(LEVEL_COUNT)]
    # The cells of levels 0 to 2 are small enough for footprints of the first kind.
    np.testing.assert_allclose(said, 3 * [0.1 / 1.1] + 3 * [1.0 / 1.1], rtol=1e-5)


def test_cells_are_found_again_and_no_two_are_taken_for_one(rng):
    count = 20000
    position = (rng.random((count, 3)) * 200.0 - 100.0).astype(np.float32)
    value = rng.random(count).astype(np.float32)
    model = CellModel()
    model.field = empty_cells(1e-3)
    model.learn(records(position, UP, value[:, None], 1e-3 * ASKS[0]))
    slots = find(model.field, position, UP, 0)
    assert (slots >= 0).all() and len(np.unique(slots)) == count
    np.testing.assert_allclose(model.field.sums[slots, 0], value, rtol=1e-6)
    # Two records in a large cell at the most: nothing else is lost.
    assert model.lost_count <= 1e-3 * count * LEVEL_COUNT


def test_a_full_table_counts_what_it_has_no_room_for(rng):
    model = CellModel()
    model.field = empty_cells(1e-3, slot_count=8)
    model.field.tag[:] = 1
    model.learn(records(np.ones((10, 3), np.float32), UP, 1.0, 1e-3 * ASKS[0]))
    assert model.lost_count == 10 * LEVEL_COUNT


@pytest.mark.parametrize("scale", [1e-4, 1.0, 1e6])
def test_sizes_of_cells_follow_the_scene(rng, scale):
    position = (scale * rng.random((2000, 3))).astype(np.float32)
    model = CellModel()
    model.learn(records(position, UP, 1.0, 1.0))
    assert 0.9 * scale / 256 < _size(model.field, 0) < scale / 256


def test_where_nothing_teaches_nothing_is_known():
    model = CellModel()
    model.learn(records(np.zeros((0, 3), np.float32), UP, 1.0, 1.0))
    assert model.field is None
    assert (find(no_cells(), [(0.0, 0.0, 0.0)], UP, 0) == -1).all()
