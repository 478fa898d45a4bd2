# SPDX-License-Identifier: GPL-3.0-or-later
"""Kernels that look at every index: for tests, and for hunts after a fault in memory.

Where `NEURALGUIDE_CHECK_BOUNDS` is set to 1, kernels are compiled with a comparison at each element that they read or
write. An index outside is reported once for each place, on the error stream and in `found`, and the element at 0 stands
in for the one that is not there. An array that is no field of a bundle has its kernel end instead. The kernels are
others than those without comparisons: the cache keeps both.

What is not looked at: memory by its address (`engine.kernels.addresses`), what Embree reads, and the blocks of
`engine.guiding.neural.networks.perceptron`.
"""

from __future__ import annotations

import ctypes
import os
from typing import Any

import llvmlite.binding as llvm
from llvmlite import ir
from numba.core import cgutils

VARIABLE = "NEURALGUIDE_CHECK_BOUNDS"
#: Whether kernels of this process look at their indices.
is_checked = os.environ.get(VARIABLE, "0") not in {"", "0"}
#: What was outside, a sentence for each place.
found: list[str] = []

_SYMBOL = "neuralguide_outside"
_WORD = ir.IntType(64)
_seen: set[bytes] = set()
#: What is being lowered: kernel and line.
_place = ["", 0]


def _report(where: bytes, index: int, size: int) -> None:
    if where in _seen:
        return
    _seen.add(where)
    found.append(f"{where.decode()}: index {index} of {size}")
    os.write(2, f"outside: {found[-1]}\n".encode())


# Kept as long as the process lives: machine code calls it.
_called = ctypes.CFUNCTYPE(None, ctypes.c_char_p, ctypes.c_int64, ctypes.c_int64)(_report)

if is_checked:
    llvm.add_symbol(_SYMBOL, ctypes.cast(_called, ctypes.c_void_p).value)  # type: ignore[no-untyped-call]


def stand_at(kernel: str, line: int) -> None:
    """Say what is being lowered, for reports."""
    _place[:] = kernel, line


def _call_report(context: Any, builder: Any, index: Any, size: Any, what: str) -> None:
    text = ir.IntType(8).as_pointer()
    function = cgutils.get_or_insert_function(
        builder.module, ir.FunctionType(ir.VoidType(), [text, _WORD, _WORD]), _SYMBOL
    )
    where = context.insert_const_string(builder.module, f"{_place[0]} line {_place[1]}, {what}")
    builder.call(function, [where, index, size])


def within(context: Any, builder: Any, index: Any, size: Any, what: str) -> Any:
    """An index, LLVM's 64 bits, as it is; where it is looked at and outside, it is reported, and 0.

    Parameters
    ----------
    size : LLVM's 64 bits
        The index must be below, and not negative.
    what : str
        What has so many elements.
    """
    if not is_checked:
        return index
    is_outside = builder.icmp_unsigned(">=", index, size)
    with cgutils.if_unlikely(builder, is_outside):
        _call_report(context, builder, index, size, what)
    return builder.select(is_outside, ir.Constant(_WORD, 0), index)


def several_within(context: Any, builder: Any, array: Any, first: Any, last: Any) -> Any:
    """As `within`, of the first and the last of several elements along an array's last axis: the first.

    Parameters
    ----------
    array : numba's structure of an array
    first, last : LLVM's 64 bits
    """
    if not is_checked:
        return first
    size = cgutils.unpack_tuple(builder, array.shape)[-1]
    first = within(context, builder, first, size, "the first of several")
    within(context, builder, last, size, "the last of several")
    return builder.select(builder.icmp_unsigned("<", last, size), first, ir.Constant(_WORD, 0))


def all_within(context: Any, builder: Any, array: Any, indices: list[Any]) -> list[Any]:
    """As `within`, for each axis of an array."""
    if not is_checked:
        return indices
    sizes = cgutils.unpack_tuple(builder, array.shape)
    return [
        within(context, builder, index, size, f"axis {axis}")
        for axis, (index, size) in enumerate(zip(indices, sizes, strict=True))
    ]


def _check_array(context: Any, builder: Any, ind: Any, dimlen: Any, axis: Any = None) -> None:
    """In the place of numba's own comparison, whose exception nobody hears of where stages are called by address."""
    with cgutils.if_unlikely(builder, builder.icmp_unsigned(">=", ind, dimlen)):
        _call_report(context, builder, ind, dimlen, "an array")
        context.call_conv.return_user_exc(builder, IndexError, ("index is out of bounds",))


if is_checked:
    cgutils.do_boundscheck = _check_array
