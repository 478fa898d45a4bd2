# SPDX-License-Identifier: GPL-3.0-or-later
"""Limits of numbers that may be none: a number comes out, as in Cycles."""

from __future__ import annotations

import math

import numpy as np
import pytest

from engine.kernels.limits import at_least, at_most, clamp, clamp_unit, larger, smaller

NAN, LOW, HIGH = np.float32(math.nan), np.float32(-0.5), np.float32(2.0)


@pytest.mark.parametrize(("x", "limited"), [(-3.0, -0.5), (0.25, 0.25), (7.0, 2.0), (math.inf, 2.0), (math.nan, -0.5)])
def test_clamped_numbers(x: float, limited: float) -> None:
    assert clamp(np.float32(x), LOW, HIGH) == limited
    assert clamp_unit(np.float32(x)) == min(max(limited, 0.0), 1.0)


def test_what_is_no_number_gives_the_limit() -> None:
    assert at_least(NAN, LOW) == LOW and at_most(NAN, HIGH) == HIGH
    assert at_least(HIGH, LOW) == HIGH and at_most(LOW, HIGH) == LOW
    # As Cycles' clamp does: the upper limit is the last word.
    assert clamp(np.float32(0.0), HIGH, LOW) == LOW


@pytest.mark.parametrize("pair", [(LOW, HIGH), (HIGH, LOW)])
def test_the_smaller_and_the_larger_of_two(pair: tuple[np.float32, np.float32]) -> None:
    assert smaller(*pair) == LOW and larger(*pair) == HIGH
    for function in (smaller, larger):
        assert function(pair[0], NAN) == function(NAN, pair[0]) == pair[0]
        assert math.isnan(function(NAN, NAN))
