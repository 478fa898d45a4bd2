# SPDX-License-Identifier: GPL-3.0-or-later
"""The four channels of texels at once: one vector instruction where a loop would take each channel in turn."""

from typing import Any

import numba
import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

from engine.runtime.bounds import several_within
from engine.runtime.bundle import FieldType, array_of

_WORD = ir.IntType(32)
_FOUR = ir.VectorType(ir.FloatType(), 4)


def _array_type(typ: Any) -> Any:
    return typ.array_type if isinstance(typ, FieldType) else typ


@intrinsic
def _blend(
    typing_context: Any, pixels: Any, first: Any, second: Any, third: Any, fourth: Any, a: Any, b: Any, c: Any, d: Any
) -> Any:

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        array_type = _array_type(signature.args[0])
        rows = array_of(context, builder, signature.args[0], arguments[0])
        is_float = array_type.dtype == types.float32
        stored = _FOUR if is_float else ir.VectorType(ir.IntType(8), 4)
        total = None
        for index, weight in zip(arguments[1:5], arguments[5:], strict=True):
            index = several_within(context, builder, rows, index, builder.add(index, ir.Constant(index.type, 3)))
            pointer = cgutils.get_item_pointer(context, builder, array_type, rows, [index])
            texel = builder.load(builder.bitcast(pointer, stored.as_pointer()), align=4 if is_float else 1)
            if not is_float:
                texel = builder.uitofp(texel, _FOUR)
            first_weight = builder.insert_element(ir.Constant(_FOUR, ir.Undefined), weight, ir.Constant(_WORD, 0))
            weights = builder.shuffle_vector(
                first_weight, first_weight, ir.Constant(ir.VectorType(_WORD, 4), [0] * 4)
            )
            weighed = builder.fmul(weights, texel)
            total = weighed if total is None else builder.fadd(total, weighed)
        return cgutils.pack_array(builder, [builder.extract_element(total, ir.Constant(_WORD, k)) for k in range(4)])

    index, weight = types.int64, types.float32
    return types.UniTuple(types.float32, 4)(pixels, *[index] * 4, *[weight] * 4), generate


def _blend_in_python(pixels: Any, *rest: Any) -> Any:
    rows = [pixels[at : at + 4].astype(np.float32) for at in rest[:4]]
    blended = sum(weight * row for weight, row in zip(rest[4:], rows, strict=True))
    return tuple(np.float32(x) for x in blended)


#: `blend_four(pixels, first, second, third, fourth, a, b, c, d)`: RGBA of four texels of a uint8 or float32 pool, each
#: given by the index of its red, weighed by a to d.
blend_four = _blend_in_python if numba.config.DISABLE_JIT else _blend
