# SPDX-License-Identifier: GPL-3.0-or-later
"""Arithmetic of von Mises-Fisher lobes, written so that LLVM turns loops over lobes into vector code.

A lobe is v(w) = C(kappa) exp(-kappa |w - mu|^2 / 2): for unit vectors |w - mu|^2 / 2 is 1 - cos, but it keeps its
precision where cos is close to 1 (at kappa 1e4 the cosine itself is off by a percent of the lobe's width) and can never
be negative, so sampling and density need no clamp that could differ between them.
"""

import numpy as np
from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from engine.runtime.jit import kernel

_LOG2_E = np.float32(1.4426950408889634)

#: Below this a lobe is uniform, in sampling and density alike.
UNIFORM_KAPPA = np.float32(1e-3)


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
def spread(kappa):
    """(1 - exp(-2 kappa)) / (2 kappa): C(kappa) = 1 / (4 pi spread), 1 for a uniform lobe."""
    divided = (1.0 - exp_nonpositive(-2.0 * kappa)) / (2.0 * max(kappa, 1e-4))
    series = 1.0 - kappa * (1.0 - 0.6666667 * kappa)
    return divided if kappa > 0.01 else series
