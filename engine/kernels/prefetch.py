# SPDX-License-Identifier: GPL-3.0-or-later
"""Asking for memory before it is needed: a scene does not fit into the caches, and a miss costs as much as a stage."""

from typing import Any

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic
from numba.np.arrayobj import make_array

_READ, _KEEP, _DATA = 0, 3, 1


@intrinsic
def prefetch(typing_context: Any, array: Any, row: Any) -> Any:
    """Have the processor fetch the start of a row of a C-contiguous array. Rows out of range do no harm."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        pointer, flag = ir.IntType(8).as_pointer(), ir.IntType(32)
        fields = make_array(signature.args[0])(context, builder, arguments[0])
        stride = builder.extract_value(fields.strides, 0)
        address = builder.gep(builder.bitcast(fields.data, pointer), [builder.mul(arguments[1], stride)])
        function = cgutils.get_or_insert_function(
            builder.module, ir.FunctionType(ir.VoidType(), [pointer, flag, flag, flag]), "llvm.prefetch.p0"
        )
        builder.call(function, [address, *(ir.Constant(flag, value) for value in (_READ, _KEEP, _DATA))])
        return context.get_dummy_value()

    return types.void(array, types.intp), generate
