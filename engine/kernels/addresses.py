# SPDX-License-Identifier: GPL-3.0-or-later
"""Memory by its address: what a library hands to a kernel that it calls."""

from typing import Any

from llvmlite import ir
from numba import types
from numba.extending import intrinsic

_WORD = ir.IntType(64)
_HALF = ir.IntType(32)


def _place(builder: Any, arguments: Any, kind: Any) -> Any:
    return builder.inttoptr(builder.add(arguments[0], arguments[1]), kind.as_pointer())


@intrinsic
def read_word(typing_context: Any, address: Any, offset: Any) -> Any:
    """64 bits at so many bytes behind an address."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.load(_place(builder, arguments, _WORD))

    return types.int64(types.int64, types.int64), generate


@intrinsic
def read_half(typing_context: Any, address: Any, offset: Any) -> Any:
    """32 bits at so many bytes behind an address, as a number that is not negative."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.zext(builder.load(_place(builder, arguments, _HALF)), _WORD)

    return types.int64(types.int64, types.int64), generate


@intrinsic
def read_real(typing_context: Any, address: Any, offset: Any) -> Any:
    """A float32 at so many bytes behind an address."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.load(_place(builder, arguments, ir.FloatType()))

    return types.float32(types.int64, types.int64), generate


@intrinsic
def write_half(typing_context: Any, address: Any, offset: Any, value: Any) -> Any:
    """Write 32 bits at so many bytes behind an address."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        builder.store(builder.trunc(arguments[2], _HALF), _place(builder, arguments, _HALF))
        return context.get_dummy_value()

    return types.void(types.int64, types.int64, types.int64), generate
