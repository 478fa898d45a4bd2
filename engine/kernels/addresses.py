# SPDX-License-Identifier: GPL-3.0-or-later
"""Memory by its address, which is what a library hands to a kernel that it calls, and kernels by theirs."""

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


def kernel_address(function: Any, returned: Any, *argument_types: Any) -> int:
    """Load or compile a kernel; where its machine code is for such arguments, which stays there.

    Parameters
    ----------
    function : kernel
    returned, *argument_types : numba types
        As of `kernel_call`, which calls it; every type is said.

    Raises
    ------
    TypeError
        The kernel returns something else than its callers take.
    """
    function.dispatcher.compile(argument_types)
    made = function.dispatcher.overloads[argument_types]
    if made.signature.return_type != returned:
        raise TypeError(f"{function.__name__} returns {made.signature.return_type}, not {returned}")
    return made.library.get_pointer_to_function(made.fndesc.llvm_func_name)


def kernel_call(returned: Any, *argument_types: Any) -> Any:
    """What an intrinsic returns that calls the kernel at an address, as a function of the types that it is given.

    Parameters
    ----------
    returned, *argument_types : numba types
        Those of the kernel; None: whatever is passed.
    """

    def typed(arguments: tuple[Any, ...]) -> Any:
        known = [given if wanted is None else wanted for given, wanted in zip(arguments, argument_types, strict=True)]

        def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
            function_type = context.call_conv.get_function_type(signature.return_type, signature.args[1:])
            function = builder.inttoptr(values[0], function_type.as_pointer())
            # Kernels do not raise: there is no status to look at.
            _status, result = context.call_conv.call_function(
                builder, function, signature.return_type, signature.args[1:], values[1:]
            )
            return result

        return returned(types.int64, *known), generate

    return typed
