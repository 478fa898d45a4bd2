# SPDX-License-Identifier: GPL-3.0-or-later
"""Exponentials without calls, which make their caller put all it holds aside and keep loops from being vectors."""

import numpy as np
from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from engine.runtime.jit import kernel

_LOG2_E = np.float32(1.4426950408889634)
#: Where `decay` ends.
_MOST_DEPTH = np.float32(87.0)


@intrinsic
def _power_of_two(typing_context, exponent):
    """2**exponent as float32 for int32 exponents in [-126, 127], by setting the exponent's bits."""

    def codegen(context, builder, signature, arguments):
        biased = builder.add(arguments[0], ir.Constant(arguments[0].type, 127))
        return builder.bitcast(builder.shl(biased, ir.Constant(biased.type, 23)), ir.FloatType())

    return types.float32(types.int32), codegen


@kernel
def exp_nonpositive(x):
    """exp(x) for x <= 0, relative error below 2e-7 (of 2**-126 at the least); free of calls and branches.

    The polynomial is a minimax fit of 2**f over (-1, 0] with the constant term fixed at 1.
    """
    scaled = max(x * _LOG2_E, -126.0)
    whole = np.int32(scaled)
    f = scaled - np.float32(whole)
    p = 0.0009448999147926435 * f + 0.009205788438368584
    p = p * f + 0.0552973493246056
    p = p * f + 0.24018013954606632
    p = p * f + 0.6931437207352683
    return (p * f + 1.0) * _power_of_two(whole)


@kernel
def decay(depth):
    """exp(-depth) for depth >= 0, infinity included, relative error below 2e-7; 0 where that is no normal float."""
    return exp_nonpositive(-depth) if depth < _MOST_DEPTH else np.float32(0.0)
