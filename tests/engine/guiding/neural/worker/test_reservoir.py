# SPDX-License-Identifier: GPL-3.0-or-later
"""The rows that training draws from: as even a sample of all that came as there is room for."""

import numpy as np
import pytest

from engine.guiding.neural.worker.reservoir import RowReservoir


def values(reservoir):
    return reservoir.take(np.arange(reservoir.count)).ravel()


def make(capacity, seed=1):
    return RowReservoir(capacity, 1, np.random.default_rng(seed))


def parts_of(sizes):
    return [np.full((size, 1), part, np.float32) for part, size in enumerate(sizes)]


def test_all_is_held_while_there_is_room():
    reservoir = make(10)
    reservoir.add(np.arange(4, dtype=np.float32)[:, None])
    reservoir.add(np.arange(4, 10, dtype=np.float32)[:, None])
    assert values(reservoir).tolist() == list(range(10))


@pytest.mark.parametrize("sizes", [(3000, 3000, 6000, 12000), (100, 20000, 1000), (5000,) * 8])
def test_every_row_is_held_as_likely_as_any_other(sizes):
    capacity = 2000
    reservoir = make(capacity)
    for rows in parts_of(sizes):
        reservoir.add(rows)
    assert reservoir.count == capacity
    held = np.bincount(values(reservoir).astype(int), minlength=len(sizes))
    expected = capacity * np.array(sizes) / sum(sizes)
    # Five standard deviations of a part's count if rows were held independently: what is wrong by chance in 2e-6.
    assert (np.abs(held - expected) < 5.0 * np.sqrt(expected) + 2.0).all(), (held, expected)


def test_rows_of_a_part_differ():
    """A part that is thinned has none of its rows twice."""
    reservoir = make(500)
    reservoir.add(np.arange(2000, dtype=np.float32)[:, None])
    reservoir.add(np.arange(2000, 4000, dtype=np.float32)[:, None])
    assert len(set(values(reservoir).tolist())) == 500


def test_single_rows_find_their_share():
    """Parts that are worth less than one place are not always left out, nor always let in."""
    reservoir = make(100)
    for k in range(4000):
        reservoir.add(np.full((1, 1), k >= 2000, np.float32))
    # 50 of 100 expected; 5 standard deviations.
    assert abs(values(reservoir).sum() - 50.0) < 25.0


def test_what_is_told_is_kept():
    reservoir = make(100)
    for rows in parts_of((30,) * 6):
        reservoir.add(rows)
    held = values(reservoir)
    reservoir.keep(held != 2.0)
    assert np.array_equal(values(reservoir), held[held != 2.0])
    # Those kept stand for themselves: what comes has room as if nothing had been before.
    reservoir.add(np.full((10, 1), 9, np.float32))
    assert np.count_nonzero(values(reservoir) == 9.0) == 10
    reservoir.keep(np.zeros(reservoir.count, bool))
    assert reservoir.count == 0
    reservoir.keep(np.zeros(0, bool))
    reservoir.add(np.full((5, 1), 7, np.float32))
    assert values(reservoir).tolist() == [7.0] * 5


def test_nothing_changes_nothing():
    reservoir = make(10)
    for size in (0, 15, 0):
        reservoir.add(np.arange(size, dtype=np.float32)[:, None])
    assert reservoir.count == 10
