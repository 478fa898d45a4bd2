# SPDX-License-Identifier: GPL-3.0-or-later
"""A column of records is declared once: allocated, joined, cut and sent to other processes by that."""

from __future__ import annotations

import numpy as np
import pytest

from engine.array_types import Float32Array
from engine.cluster import work
from engine.guiding.records import vertices
from engine.guiding.records.cache_records import CacheRecords, allocate_cache_records, join_cache_records
from engine.guiding.records.light import Records
from engine.guiding.records.unit_records import UnitRecords
from engine.guiding.records.vertices import VertexRecords, allocate_vertex_records, as_records, join_records
from engine.render.traced import TracedTiles
from engine.state.columns import column, columns_of, copy_of, rows_of
from engine.state.film import PLAIN_LAYOUT, allocate_tile
from engine.state.unit import UnitCosts


class ToyRecords(VertexRecords):
    """Records with a column more."""

    toy: Float32Array = column("toys", "R", 2, fill=4.0)


@pytest.fixture
def toys(monkeypatch):
    for module in (vertices, work):
        monkeypatch.setattr(module, "VertexRecords", ToyRecords)


def filled(table, rng):
    """The table, with other numbers in each row and column."""
    for values in table:
        values[...] = rng.uniform(1.0, 100.0, values.shape)
    return table


def sent(units):
    """What another process has of records of units."""
    traced = TracedTiles(allocate_tile(1, 3), [UnitCosts()] * len(units), units)
    return work.unpack_traced(work.pack_traced(traced), PLAIN_LAYOUT).records


def test_a_toy_column_is_allocated_joined_and_cut(toys):
    assert (allocate_vertex_records(3).toy == 4.0).all()
    rng = np.random.default_rng(1)
    units = [filled(allocate_vertex_records(count), rng) for count in (2, 3)]
    together, count = join_records(units)
    assert count == 5 and type(together) is ToyRecords
    np.testing.assert_array_equal(together.toy, np.concatenate([unit.toy for unit in units]))
    part = copy_of(rows_of(together, 2, 5))
    together.toy[:] = 0.0
    np.testing.assert_array_equal(part.toy, units[1].toy)


def test_a_toy_column_goes_to_other_processes(toys):
    rng = np.random.default_rng(2)
    units = [
        UnitRecords(filled(allocate_vertex_records(count), rng), filled(allocate_cache_records(1), rng))
        for count in (2, 0, 3)
    ]
    there = sent(units)
    for here, unit in zip(units, there, strict=True):
        np.testing.assert_array_equal(unit.vertices.toy, here.vertices.toy)


@pytest.mark.parametrize("channel_count", [3, 4])
def test_no_column_is_lost_on_the_way(channel_count):
    rng = np.random.default_rng(3)
    units = [
        UnitRecords(filled(allocate_vertex_records(2, channel_count), rng), filled(allocate_cache_records(3), rng))
        for _ in range(2)
    ]
    there = sent(units)
    vertices, cached = [unit.vertices for unit in there], [unit.cache_records for unit in there]
    joined = join_records(vertices)[0], join_cache_records(cached)
    for table, found, of_units in zip((VertexRecords, CacheRecords), joined, zip(*units, strict=True), strict=True):
        assert list(columns_of(table)) == list(table._fields)
        for name in table._fields:
            wanted = np.concatenate([getattr(unit, name) for unit in of_units])
            assert getattr(found, name).dtype == wanted.dtype
            np.testing.assert_array_equal(getattr(found, name), wanted, name)


def test_fields_get_the_columns_that_they_ask_for():
    records = filled(allocate_vertex_records(4), np.random.default_rng(4))
    for name, values in as_records(records)._asdict().items():
        assert name in Records._fields and values is getattr(records, name)
