# SPDX-License-Identifier: GPL-3.0-or-later
"""Cells of what surfaces send back: what they learn, who answers, and what nobody has met."""

import numpy as np
import pytest

from engine.guiding.fields.roulette.field import SLOT_COUNT, empty_roulette_field, find_importance
from engine.guiding.fields.roulette.model import RouletteFieldModel
from engine.guiding.records.vertices import allocate_vertex_records

SHADER, OTHER_SHADER = 3, 4
UP = (np.float32(0.0), np.float32(0.0), np.float32(1.0))
DOWN = (np.float32(0.0), np.float32(0.0), np.float32(-1.0))


def floor_records(count=1 << 14, seed=0):
    """Records of a floor of 8 by 8 m: two thirds of it dark, the rest ten times as bright, and everything costs two."""
    rng = np.random.default_rng(seed)
    records = allocate_vertex_records(count)
    records.position[:, :2] = rng.random((count, 2)) * 8.0
    records.normal[:] = UP
    records.program[:] = SHADER
    records.outgoing_radiance[:] = np.where(records.position[:, 0] > 5.0, 1.0, 0.1)
    records.cost[:] = 2.0
    return records


def importance_at(field, x, y, normal=UP, shader=SHADER):
    return float(find_importance(field, (np.float32(x), np.float32(y), np.float32(0.0)), normal, shader))


@pytest.fixture(scope="module")
def field():
    model = RouletteFieldModel()
    records = floor_records()
    model.learn(records, len(records.cost))
    assert model.lost_count == 0
    return model.field


def test_cells_know_the_second_moment_over_the_cost(field):
    # The cells around them have a share, and these lie in one light alone.
    assert importance_at(field, 7.1, 3.0) == pytest.approx(1.0 / np.sqrt(2.0), rel=0.05)
    assert 0.1 / np.sqrt(2.0) < importance_at(field, 1.0, 3.0) < 0.2 / np.sqrt(2.0)


def test_another_side_and_another_shader_are_not_known(field):
    assert np.isnan(importance_at(field, 7.1, 3.0, DOWN))
    assert np.isnan(importance_at(field, 7.1, 3.0, shader=OTHER_SHADER))
    assert np.isnan(importance_at(field, 100.0, 3.0))


def test_a_field_that_knows_nothing_says_so():
    assert np.isnan(importance_at(empty_roulette_field(), 1.0, 1.0))


def test_large_cells_answer_where_no_small_one_is():
    records = floor_records(512)
    model = RouletteFieldModel()
    model.learn(records, 512)
    found = [importance_at(model.field, x, y) for x in np.arange(0.1, 8.0, 0.3) for y in np.arange(0.1, 8.0, 0.3)]
    assert np.isfinite(found).mean() > 0.9


def test_a_single_record_does_not_make_a_cell_dark():
    """A cell that has met nothing of the light around it yet."""
    records = floor_records(1 << 12)
    model = RouletteFieldModel()
    records.outgoing_radiance[:] = 1.0
    records.outgoing_radiance[0] = 0.0
    records.position[0] = (100.0, 100.0, 0.0)
    model.learn(records, len(records.cost))
    assert importance_at(model.field, 100.0, 100.0) == pytest.approx(1.0 / np.sqrt(2.0), rel=0.1)


def test_a_single_record_does_not_make_others_bright():
    """Cells that have never met the like stay dark: paths would be long there for nothing."""
    records = floor_records(1 << 12)
    records.outgoing_radiance[:] = 1.0
    records.outgoing_radiance[0] = 100.0
    records.position[0] = (8.0, 8.0, 0.0)
    model = RouletteFieldModel()
    model.learn(records, len(records.cost))
    assert importance_at(model.field, 1.0, 1.0) == pytest.approx(1.0 / np.sqrt(2.0), rel=0.1)
    assert importance_at(model.field, 7.99, 7.99) > 0.8


def test_what_the_table_has_no_room_for_is_counted():
    rng = np.random.default_rng(1)
    records = allocate_vertex_records(4 * SLOT_COUNT)
    records.position[:] = rng.random((4 * SLOT_COUNT, 3))
    records.normal[:] = UP
    records.program[:] = np.arange(4 * SLOT_COUNT) % 1000
    records.cost[:] = 1.0
    model = RouletteFieldModel()
    model.learn(records, 4 * SLOT_COUNT)
    assert model.lost_count > 0
    assert (model.field.tag != 0).mean() > 0.9
