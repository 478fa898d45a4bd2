# SPDX-License-Identifier: GPL-3.0-or-later
"""Patterns that few scenes have: the interpreter calls their kernel by its address.

`ops_patterns.py` has the kernel, and puts its address into `BsdfTables.linked` when a program first asks for it.
"""

from typing import Any

from numba import types
from numba.extending import intrinsic

from engine.kernels.addresses import kernel_call
from engine.kernels.bsdf.linked import PATTERNS
from engine.runtime.jit import kernel

_run = kernel_call(types.int64, None, types.int64, None)


@intrinsic
def _call_run(typing_context: Any, address: Any, code: Any, pc: Any, memory: Any) -> Any:
    return _run((code, pc, memory))


@kernel(forceinline=True)
def run_linked_pattern(tables, code, pc, memory):
    """Run the instruction at `pc`, one of `ops_patterns`. `tables` is the BsdfTables."""
    _call_run(tables.linked[PATTERNS], code, pc, memory)
