# SPDX-License-Identifier: GPL-3.0-or-later
"""`StageTable`: kernels that a compiled loop calls through pointers.

A kernel that calls another one by name holds its machine code too: a loop over all stages would compile them all once
more, in one piece that no other process can help with. Through the table the loop knows no more of a stage than what it
returns, and the stages stay as they were compiled and cached.

In Python the table's attributes are the stages, so that the same loop runs there too, on other functions if need be.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from llvmlite import ir
from numba import types
from numba.core.imputils import lower_builtin, lower_getattr_generic
from numba.core.typing.templates import AttributeTemplate, signature
from numba.extending import infer_getattr, register_model, unbox

from engine.bundle import AddressModel, unbox_address
from engine.jit import BoundKernel, call_type


class StageTableType(types.Type):
    """Numba's type of a table: names in order, and how many integers each stage returns."""

    def __init__(self, returns: tuple[tuple[str, int], ...]) -> None:
        self.returns = returns
        self.index = {name: k for k, (name, _) in enumerate(returns)}
        super().__init__(name=f"StageTable({returns})")


class StageType(types.Callable):
    """Numba's type of one of a table's stages: the address of its machine code."""

    #: Arguments that each stage was last compiled to be called with, for tests.
    called_with: dict[str, tuple[Any, ...]] = {}  # noqa: RUF012

    def __init__(self, name: str, return_count: int) -> None:
        self.stage, self.return_count = name, return_count
        super().__init__(name=f"Stage({name}, {return_count})")

    def get_call_type(self, context: Any, args: Any, kws: Any) -> Any:
        """Whatever is passed, literals aside."""
        arguments = tuple(call_type(argument) for argument in args)
        self.called_with[self.stage] = arguments
        returned = (types.none, types.int64)[self.return_count] if self.return_count < 2 else None
        return signature(returned or types.UniTuple(types.int64, self.return_count), *arguments, recvr=self)

    def get_call_signatures(self) -> tuple[list, bool]:
        """None are known ahead."""
        return [], False

    def get_impl_key(self, sig: Any) -> Any:
        """One implementation for all."""
        return StageType


for _type in (StageTableType, StageType):
    register_model(_type)(AddressModel)
unbox(StageTableType)(unbox_address)


@infer_getattr
class _TableAttributes(AttributeTemplate):
    key = StageTableType

    def generic_resolve(self, typ: StageTableType, attr: str) -> types.Type | None:
        return StageType(attr, dict(typ.returns)[attr]) if attr in typ.index else None


@lower_getattr_generic(StageTableType)
def _lower_attribute(context: Any, builder: Any, typ: StageTableType, value: Any, attr: str) -> Any:
    word = ir.IntType(64)
    table = builder.inttoptr(value, word.as_pointer())
    return builder.load(builder.gep(table, [ir.Constant(word, typ.index[attr])]))


@lower_builtin(StageType, StageType, types.VarArg(types.Any))
def _lower_call(context: Any, builder: Any, sig: Any, args: Any) -> Any:
    returned, argument_types = sig.return_type, sig.args[1:]
    function_type = context.call_conv.get_function_type(returned, argument_types)
    function = builder.inttoptr(args[0], function_type.as_pointer())
    # Kernels do not raise: there is no status to look at.
    _status, result = context.call_conv.call_function(builder, function, returned, argument_types, args[1:])
    return result


class StageTable:
    """Stages by name.

    Parameters
    ----------
    stages : mapping of str to (callable, int)
        Kernel or plain function, and how many int64 it returns: none, one, or a tuple. Kernels must take and return no
        other integers.
    """

    def __init__(self, stages: Mapping[str, tuple[Callable[..., Any], int]]) -> None:
        self._returns = tuple((name, count) for name, (_, count) in stages.items())
        self._stages = {
            name: BoundKernel(stage) if hasattr(stage, "overloads") else stage for name, (stage, _) in stages.items()
        }
        self._pointers = np.zeros(len(stages), np.int64)
        self._address = self._pointers.ctypes.data
        self._numba_type_ = StageTableType(self._returns)

    def __getattr__(self, name: str) -> Callable[..., Any]:
        stages = self.__dict__.get("_stages", {})
        if name in stages:
            return stages[name]
        raise AttributeError(name)

    def as_dict(self) -> dict[str, Callable[..., Any]]:
        """Stages to be called from Python."""
        return dict(self._stages)

    def link(self) -> bool:
        """Make the table usable in kernels; False if a stage is no kernel.

        Stages that were never called from Python stay out: compiled code must not reach them.

        Raises
        ------
        TypeError
            If a stage returns anything else than was said.
        """
        for index, (name, count) in enumerate(self._returns):
            stage = self._stages[name]
            if not isinstance(stage, BoundKernel):
                return False
            if stage.is_bound:
                returned = stage.signature.return_type
                kept = 0 if returned == types.none else getattr(returned, "count", 1)
                if kept != count or (kept and getattr(returned, "dtype", returned) != types.int64):
                    raise TypeError(f"stage {name} returns {returned}, not {count} int64")
                self._pointers[index] = stage.address
        return True
