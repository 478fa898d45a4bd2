# SPDX-License-Identifier: GPL-3.0-or-later
"""A few floats of a kernel's own: kernels do not allocate, and tuples cannot be written to by index."""

from typing import Any

import numba
import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

from engine.runtime.bundle import RowsType, rows_at

#: Floats that `local_floats` has room for.
LOCAL_COUNT = 8


@intrinsic
def _on_the_stack(typing_context: Any) -> Any:

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        room = cgutils.alloca_once(builder, ir.ArrayType(ir.FloatType(), LOCAL_COUNT))
        return rows_at(builder, builder.bitcast(room, ir.IntType(8).as_pointer()), LOCAL_COUNT)

    return RowsType(types.float32, (), (4,))(), generate


def _in_python() -> Any:
    return np.zeros(LOCAL_COUNT, np.float32)


#: `local_floats()`: room for `LOCAL_COUNT` float32, not set; valid until the kernel that asks returns.
local_floats = _in_python if numba.config.DISABLE_JIT else _on_the_stack
