# SPDX-License-Identifier: GPL-3.0-or-later
"""Rounding down by an instruction is `math.floor`."""

import math

import numpy as np

from engine.kernels.rounding import floor_of
from engine.runtime.jit import kernel


@kernel
def _floor_all(values, out):
    for k in range(values.shape[0]):
        out[k] = floor_of(values[k])


def test_it_is_what_python_says() -> None:
    numbers = [0.0, -0.0, 0.5, -0.5, 1.0, -1.0, 2.9999998, -3.0000002, 1e-30, -1e-30, 8388607.5, -8388607.5, 4e9, -4e9]
    for dtype in (np.float32, np.float64):
        values, out = np.array(numbers, dtype), np.zeros(len(numbers), np.int64)
        _floor_all(values, out)
        assert out.tolist() == [math.floor(value) for value in values]
