# SPDX-License-Identifier: GPL-3.0-or-later
"""Bundles: arrays seen by kernels through one pointer."""

import pickle

import numpy as np
import pytest

from engine.bundle import Bundle
from engine.jit import kernel


class Pair(Bundle):
    """Two arrays and a width."""

    real: np.ndarray
    integer: np.ndarray
    channels: tuple[int, ...]


class Varying(Bundle):
    """An array whose inner size is no part of the type."""

    _dynamic = frozenset({"rows"})
    rows: np.ndarray


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
def _last(varying):
    return varying.rows[varying.rows.shape[0] - 1, varying.rows.shape[1] - 1]


def test_kernels_read_and_write_the_arrays():
    pair = Pair(np.ones((5, 4), np.float32), np.zeros(5, np.int32), (0, 1, 2))
    _scale_all(pair, np.float32(3.0))
    assert np.array_equal(pair.real, np.repeat([[3, 3, 3, 1]], 5, 0))
    assert (pair.integer == 504).all()


def test_width_and_inner_shape_are_part_of_the_type_but_not_dynamic_ones():
    three = Pair(np.ones((5, 4), np.float32), np.zeros(5, np.int32), (0, 1, 2))
    four = Pair(np.ones((5, 4), np.float32), np.zeros(5, np.int32), (0, 1, 2, 3))
    longer = Pair(np.ones((9, 4), np.float32), np.zeros(9, np.int32), (0, 1, 2))
    assert three._numba_type_ != four._numba_type_
    assert three._numba_type_ == longer._numba_type_
    assert _last(Varying(np.arange(6.0).reshape(2, 3))) == 5.0
    assert _last(Varying(np.arange(8.0).reshape(2, 4))) == 7.0
    assert len(_last.signatures) == 1


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
