# SPDX-License-Identifier: GPL-3.0-or-later
"""Limits of numbers that shaders compute, which may be none.

A node may divide by zero, as a Wave Texture whose octaves cancel each other. What limits such a number gives the lower
limit, as in Cycles. `min(max(x, 0.0), 1.0)` would hand NaN on.
"""

import math

from engine.runtime.jit import kernel


@kernel
def at_least(x, low):
    """The larger of `x` and `low`; `low` for NaN."""
    return x if x > low else low


@kernel
def at_most(x, high):
    """The smaller of `x` and `high`; `high` for NaN."""
    return x if x < high else high


@kernel
def smaller(a, b):
    """The smaller of two numbers; where one is NaN, the other."""
    return a if a < b or math.isnan(b) else b


@kernel
def larger(a, b):
    """The larger of two numbers; where one is NaN, the other."""
    return a if a > b or math.isnan(b) else b


@kernel
def clamp(x, low, high):
    """`x` in [low, high]; `low` for NaN, `high` where `low` is above it."""
    return at_most(at_least(x, low), high)


@kernel
def clamp_unit(x):
    """`x` in [0, 1]; 0 for NaN."""
    return clamp(x, 0.0, 1.0)
