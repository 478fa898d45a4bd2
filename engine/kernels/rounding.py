# SPDX-License-Identifier: GPL-3.0-or-later
"""Rounding down by the processor's instruction: `math.floor` calls a function, before which all vectors are saved."""

import math
from typing import Any

import numba
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic


@intrinsic
def _round_down(typing_context: Any, x: Any) -> Any:
    if not isinstance(x, types.Float):
        return None

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        value = arguments[0]
        name = "llvm.floor.f32" if value.type == ir.FloatType() else "llvm.floor.f64"
        function = cgutils.get_or_insert_function(builder.module, ir.FunctionType(value.type, [value.type]), name)
        return builder.fptosi(builder.call(function, [value]), ir.IntType(64))

    return types.int64(x), generate


#: `floor_of(x)`: the largest int64 that is not above a float, as `math.floor`; anything for NaN.
floor_of = math.floor if numba.config.DISABLE_JIT else _round_down
