# SPDX-License-Identifier: GPL-3.0-or-later
"""Eight floats at once are what each would be alone."""

from __future__ import annotations

import numpy as np
import pytest

from engine.kernels.eight import (
    WIDTH,
    absolute,
    at,
    choose,
    count_of,
    counted_from,
    last_of,
    load_eight,
    load_from,
    root,
    sum_of,
    sums_before,
    words_apart,
    words_from,
)
from engine.runtime.jit import kernel


@kernel
def _compute(rows, group, number, out):
    a, b = load_eight(rows, group, 0), load_eight(rows, group, 1)
    difference = a - b
    is_more = (a > b) & (a <= number) | (b >= number)
    picked = choose(is_more, a * b + number, root(difference) / (number + absolute(difference)))
    before = sums_before(a)
    for k in range(WIDTH):
        out[0, k] = at(picked, k)
        out[1, k] = at(before, k)
    return last_of(is_more)


def test_they_are_what_each_is_alone() -> None:
    rows = np.random.default_rng(1).normal(size=(40, 2, WIDTH)).astype(np.float32)
    number, out = np.float32(0.7), np.zeros((2, WIDTH), np.float32)
    lasts = set()
    for group, (a, b) in enumerate(rows):
        last = _compute(rows, group, number, out)
        is_more = (a > b) & (a <= number) | (b >= number)
        otherwise = np.sqrt(np.maximum(a - b, 0.0)) / (number + np.abs(a - b))
        np.testing.assert_allclose(out[0], np.where(is_more, a * b + number, otherwise), rtol=2e-6, atol=1e-7)
        np.testing.assert_allclose(out[1], [a[:k].sum() for k in range(WIDTH)], rtol=1e-5, atol=1e-6)
        assert last == max(np.flatnonzero(is_more), default=-1)
        lasts.add(last)
    assert len(lasts) > 3


@pytest.mark.parametrize("is_set", [False, True])
def test_none_and_all(is_set: bool) -> None:
    rows = np.full((1, 2, WIDTH), 1.0 if is_set else -1.0, np.float32)
    rows[0, 1] = 0.0
    assert _compute(rows, 0, np.float32(2.0), np.zeros((2, WIDTH), np.float32)) == (WIDTH - 1 if is_set else -1)


@kernel
def _count(rows, row, first, number):
    return count_of(load_from(rows, row, first) <= number)


def test_those_that_are_no_more_than_a_number_are_counted_from_any_column() -> None:
    rows = np.random.default_rng(2).random((5, 30)).astype(np.float32)
    number = np.float32(0.6)
    for row in range(5):
        for first in range(30 - WIDTH + 1):
            expected = int((rows[row, first : first + WIDTH] <= number).sum())
            assert _count(rows, row, first, number) == expected


@kernel
def _read_words(words, first, stride, number, out):
    together, apart, counted = words_from(words, first), words_apart(words, first, stride), counted_from(number)
    for k in range(WIDTH):
        out[0, k] = at(together, k)
        out[1, k] = at(apart, k)
        out[2, k] = at(counted, k)
    return sum_of(together)


def test_words_are_read_side_by_side_and_apart() -> None:
    words = np.random.default_rng(3).integers(0, 1 << 16, 100).astype(np.uint16)
    out = np.zeros((3, WIDTH), np.float32)
    for first in range(12):
        for stride in (1, 3, 4):
            total = _read_words(words, first, stride, np.float32(first - 0.5), out)
            assert np.array_equal(out[0], words[first : first + WIDTH])
            assert np.array_equal(out[1], words[first : first + WIDTH * stride : stride])
            assert np.array_equal(out[2], first - 0.5 + np.arange(WIDTH))
            assert total == pytest.approx(words[first : first + WIDTH].sum(dtype=np.int64), rel=1e-6)
