# SPDX-License-Identifier: GPL-3.0-or-later
"""The processor's clock, for kernels that tell where time goes."""

import time
from typing import Any

import numba
import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

from engine.runtime.jit import kernel


@intrinsic
def _read_counter(typing_context: Any) -> Any:

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        function_type = ir.FunctionType(ir.IntType(64), [])
        processor = builder.module.triple.partition("-")[0]
        if processor in ("aarch64", "arm64"):  # LLVM's own intrinsic reads a counter that only systems may
            return builder.asm(function_type, "mrs $0, cntvct_el0", "=r", [], side_effect=True)
        return builder.call(cgutils.get_or_insert_function(builder.module, function_type, "llvm.readcyclecounter"), [])

    return types.int64(), generate


def _in_python() -> Any:
    return np.int64(time.perf_counter_ns())


#: `ticks()`: int64, of constant but unknown rate and beginning; read without asking the system.
ticks = _in_python if numba.config.DISABLE_JIT else _read_counter


@kernel
def mark(clock, entry):
    """Charge the ticks since the last mark to an entry of `clock`, int64; its last element holds the last mark."""
    now = ticks()
    last = clock.shape[0] - 1
    clock[entry] += now - clock[last]
    clock[last] = now


@kernel
def begin(clock):
    """Set the first mark."""
    clock[clock.shape[0] - 1] = ticks()
