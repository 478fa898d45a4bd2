# SPDX-License-Identifier: GPL-3.0-or-later
"""Piecewise linear functions: what is left of an albedo table once all but the cosine is known."""

import numpy as np

from engine.array_types import Float32Array
from engine.runtime.jit import kernel


def value_between(values: Float32Array, x: np.float32) -> Float32Array:
    """What lies at `x` in [0, 1] of the way along the last axis, as `lookup.read_table` interpolates."""
    x = x * np.float32(values.shape[-1] - 1)
    k = min(int(x), values.shape[-1] - 2)
    share = x - np.float32(k)
    between: Float32Array = values[..., k] * (np.float32(1.0) - share) + values[..., k + 1] * share
    return between


@kernel
def interpolate(memory, first, count, x):
    """Linear interpolation between `count` values from `first` on, at `x` in [0, 1] of the way."""
    x = min(max(x, 0.0), 1.0) * np.float32(count - 1)
    k = min(int(x), count - 2)
    low = memory[first + k]
    return low + (x - np.float32(k)) * (memory[first + k + 1] - low)
