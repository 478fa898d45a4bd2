# SPDX-License-Identifier: GPL-3.0-or-later
"""Bundles: arrays seen by kernels through one pointer."""

import pickle
import threading
from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple

import numba
import numpy as np
import pytest
from numba.core.registry import cpu_target

from engine.kernels.local import LOCAL_COUNT, local_floats
from engine.runtime.bundle import Bundle
from engine.runtime.jit import BoundKernel, kernel


class Pair(Bundle):
    """Two arrays and a width."""

    real: np.ndarray
    integer: np.ndarray
    channels: tuple[int, ...]


class Limits(NamedTuple):
    """Numbers of two kinds."""

    depth: int
    clamp: np.float32


class Limited(Bundle):
    """An array and numbers."""

    values: np.ndarray
    limits: Limits


class Varying(Bundle):
    """An array whose inner size is no part of the type."""

    _dynamic = frozenset({"rows"})
    rows: np.ndarray


class Lanes(Bundle):
    """Fields side by side in records."""

    _rows = True
    position: np.ndarray
    count: np.ndarray
    table: np.ndarray


@kernel
def _move(lanes, lane, distance):
    for c in range(3):
        lanes.position[lane, c] += distance
    lanes.count[lane] = lanes.count[np.int32(lane)] + 1
    lanes.table[lane, 1, 2] = lanes.table[lane, 0, 1]


@kernel
def _sum_of_room():
    room = local_floats()
    for k in range(LOCAL_COUNT):
        room[k] = np.float32(k)
    total = 0.0
    for k in range(LOCAL_COUNT):
        total += room[k]
    return total


@kernel
def _scale_row(pair, row, factor):
    for c in range(len(pair.channels)):
        pair.real[row, c] *= factor
    pair.integer[row] += pair.real.shape[0] * 100 + pair.real.shape[1]


@kernel
def _scale_all(pair, factor):
    for row in range(pair.integer.shape[0]):
        _scale_row(pair, row, factor)


@kernel
def _clamp(limited):
    for row in range(limited.limits.depth):
        limited.values[row] = min(limited.values[row], limited.limits.clamp)


@kernel
def _last(varying):
    return varying.rows[varying.rows.shape[0] - 1, varying.rows.shape[1] - 1]


@kernel
def _clear_row(varying, row):
    values, total = varying.rows[row], 0.0
    for k in range(values.shape[0]):
        total += values[k]
        values[k] = 0.0
    return total


def test_kernels_read_and_write_the_arrays():
    pair = Pair(np.ones((5, 4), np.float32), np.zeros(5, np.int32), (0, 1, 2))
    _scale_all(pair, np.float32(3.0))
    assert np.array_equal(pair.real, np.repeat([[3, 3, 3, 1]], 5, 0))
    assert (pair.integer == 504).all()


def test_width_and_inner_shape_are_part_of_the_type_but_not_dynamic_ones():
    three = Pair(np.ones((5, 4), np.float32), np.zeros(5, np.int32), (0, 1, 2))
    four = Pair(np.ones((5, 4), np.float32), np.zeros(5, np.int32), (0, 1, 2, 3))
    longer = Pair(np.ones((9, 4), np.float32), np.zeros(9, np.int32), (0, 1, 2))
    assert numba.typeof(three) != numba.typeof(four)
    assert numba.typeof(three) == numba.typeof(longer)
    assert _last(Varying(np.arange(6.0).reshape(2, 3))) == 5.0
    assert _last(Varying(np.arange(8.0).reshape(2, 4))) == 7.0
    assert len(_last.signatures) == 1


def test_a_slice_of_a_field_is_an_array():
    varying = Varying(np.arange(12.0).reshape(3, 4))
    assert _clear_row(varying, 1) == 4.0 + 5.0 + 6.0 + 7.0
    assert np.array_equal(varying.rows, [[0, 1, 2, 3], [0, 0, 0, 0], [8, 9, 10, 11]])


def test_a_field_is_one_word_at_a_call():
    varying = Varying(np.zeros((2, 3)))
    (field,) = (typ for name, typ in numba.typeof(varying).fields if name == "rows")
    assert cpu_target.target_context.get_value_type(field).width == 64


def test_numbers_of_a_named_tuple_are_read_as_such_and_their_values_are_no_part_of_the_type():
    for depth, clamp in ((2, 1.5), (3, 0.5)):
        limited = Limited(np.full(4, 2.0, np.float32), Limits(depth, np.float32(clamp)))
        _clamp(limited)
        assert np.array_equal(limited.values, np.where(np.arange(4) < depth, clamp, 2.0))
    assert len(_clamp.signatures) == 1


def test_replace_keeps_the_other_arrays_and_fields_are_fixed():
    pair = Pair(np.ones((5, 4), np.float32), np.zeros(5, np.int32), (0,))
    other = pair._replace(integer=np.ones(5, np.int32))
    assert other.real is pair.real
    with pytest.raises(AttributeError, match="_replace"):
        pair.real = other.real
    assert np.array_equal(pickle.loads(pickle.dumps(pair)).real, pair.real)


def test_what_cannot_be_a_field_is_refused():
    with pytest.raises(TypeError, match="real"):
        Pair(np.ones((5, 4), np.float32)[:, ::2], np.zeros(5, np.int32), (0,))
    with pytest.raises(TypeError, match="fields"):
        Pair(np.ones((5, 4), np.float32))


def _lanes(lane_count: int) -> Lanes:
    record = np.dtype([("position", np.float32, 3), ("count", np.uint8), ("", np.uint8, 3)])
    memory = np.zeros(lane_count, record)
    table = np.arange(lane_count * 12, dtype=np.int32).reshape(2, lane_count, 6).transpose(1, 0, 2)
    return Lanes(memory["position"], memory["count"], table)


def test_fields_of_lanes_may_be_strided_and_neighbours_stay_as_they_are():
    lanes = _lanes(5)
    expected = lanes.table.copy()
    expected[3, 1, 2] = expected[3, 0, 1]
    _move(lanes, 3, np.float32(2.0))
    _move(lanes, 3, np.float32(0.5))
    assert np.array_equal(lanes.position, np.where(np.arange(5)[:, None] == 3, 2.5, 0.0) * np.ones(3))
    assert np.array_equal(lanes.count, [0, 0, 0, 2, 0])
    assert np.array_equal(lanes.table, expected)


def test_strides_are_part_of_the_type_of_lanes():
    assert numba.typeof(_lanes(5)) != numba.typeof(_lanes(6))
    dense = Lanes(np.zeros((5, 3), np.float32), np.zeros(5, np.uint8), np.zeros((5, 2, 6), np.int32))
    assert numba.typeof(dense) != numba.typeof(_lanes(5))
    _move(dense, 1, np.float32(1.0))
    assert dense.position.sum() == 3.0


def test_bound_kernels_do_what_the_kernel_does():
    bound, lanes = BoundKernel(_move), _lanes(4)
    for lane in (0, 2, 2):
        bound(lanes, lane, np.float32(1.0))
    assert np.array_equal(lanes.count, [1, 0, 2, 0])


def test_local_floats_keep_what_is_written():
    assert _sum_of_room() == sum(range(LOCAL_COUNT))


@kernel
def _last_of(varying):
    return varying.rows[varying.rows.shape[0] - 1, varying.rows.shape[1] - 1]


def test_threads_that_ask_first_at_the_same_time_read_the_same():
    """What kernels read is made when the first asks, and is the same for all as long as the bundle lives."""
    barrier = threading.Barrier(4)

    def ask(bundle):
        barrier.wait()
        return [_last_of(bundle) for _ in range(5)]

    with ThreadPoolExecutor(4) as pool:
        for number in range(100):
            varying = Varying(np.full((2, 3), number, np.float32))
            found = [pool.submit(ask, varying) for _ in range(4)]
            assert {value for future in found for value in future.result()} == {number}


def test_bundles_alike_share_a_type():
    one, other = (Pair(np.zeros((n, 3), np.float32), np.zeros(n, np.int32), (0, 1, 2)) for n in (2, 5))
    assert numba.typeof(one) is numba.typeof(other)
    wider = Pair(np.zeros((2, 4), np.float32), np.zeros(2, np.int32), (0, 1, 2))
    assert numba.typeof(one) != numba.typeof(wider)
    assert numba.typeof(one) != numba.typeof(Pair(one.real, one.integer, (0, 1)))
