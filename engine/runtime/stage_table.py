# SPDX-License-Identifier: GPL-3.0-or-later
"""`StageTable`: kernels that a compiled loop calls through pointers.

A kernel that calls another one by name holds its machine code too: a loop over all stages would compile them all once
more, in one piece that no other process can help with. Through the table the loop knows no more of a stage than its
name, and the stages stay as they were compiled and cached. Stages return nothing: what they leave is in their bundles.

In Python the table's attributes are the stages, so that the same loop runs there too, on other functions if need be.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from llvmlite import ir
from numba import types
from numba.core.imputils import lower_builtin, lower_getattr_generic
from numba.core.typing.templates import AttributeTemplate, signature
from numba.extending import infer_getattr, register_model, unbox

from engine.runtime.bundle import AddressModel, AddressType, FieldType, unbox_address
from engine.runtime.jit import BoundKernel, Kernel, call_type


class StageTableType(AddressType):
    """Numba's type of a table: names in order."""

    def __init__(self, names: tuple[str, ...]) -> None:
        self.index = {name: k for k, name in enumerate(names)}
        # Short, as of bundles.
        digest = hashlib.blake2b(repr(names).encode(), digest_size=10).hexdigest()
        super().__init__(name=f"StageTable_{digest}")


class StageType(types.Callable):
    """Numba's type of one of a table's stages: the address of its machine code."""

    #: Arguments that each stage was compiled to be called with, for tests: once for equal types.
    called_with: dict[str, set[tuple[Any, ...]]] = {}  # noqa: RUF012

    def __init__(self, name: str) -> None:
        self.stage = name
        super().__init__(name=f"Stage({name})")

    def get_call_type(self, context: Any, args: Any, kws: Any) -> Any:
        """Whatever is passed, literals aside; arrays, as Python passes them, where the loop has a bundle's fields."""
        arguments = tuple(call_type(argument) for argument in args)
        arguments = tuple(one.array_type if isinstance(one, FieldType) else one for one in arguments)
        self.called_with.setdefault(self.stage, set()).add(arguments)
        return signature(types.none, *arguments, recvr=self)

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
        return StageType(attr) if attr in typ.index else None


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
    stages : mapping of str to callable
        Kernels or plain functions that return nothing. Kernels must take no integers but int64.
    """

    def __init__(self, stages: Mapping[str, Callable[..., Any]]) -> None:
        self._stages = {
            name: BoundKernel(stage) if isinstance(stage, Kernel) else stage for name, stage in stages.items()
        }
        self._pointers = np.zeros(len(stages), np.int64)
        self._address = self._pointers.ctypes.data
        self._numba_type_ = StageTableType(tuple(stages))

    def __getattr__(self, name: str) -> Callable[..., Any]:
        stages = self.__dict__.get("_stages", {})
        if name in stages:
            return stages[name]
        raise AttributeError(name)

    def as_dict(self) -> dict[str, Callable[..., Any]]:
        """Stages to be called from Python."""
        return dict(self._stages)

    def plug(self, name: str, stage: Callable[..., Any], *arguments: Any) -> bool:
        """Have a stage called in the place of the one of that name; no thread may be calling that.

        Parameters
        ----------
        name : str
        stage : callable
            Takes what the loop passes; of a bundle that is opaque to the loop it may know the class.
        arguments
            Values of the types that it is to be compiled for.

        Returns
        -------
        bool
            False if it is no kernel: compiled code must not reach it.
        """
        self._stages[name] = bound = BoundKernel(stage) if isinstance(stage, Kernel) else stage
        if isinstance(bound, BoundKernel):
            self._link(name, bound, arguments)
        return isinstance(bound, BoundKernel)

    def _link(self, name: str, stage: BoundKernel, arguments: tuple[Any, ...]) -> None:
        stage.bind(*arguments)
        if stage.signature.return_type != types.none:
            raise TypeError(f"stage {name} returns {stage.signature.return_type}, not nothing")
        self._pointers[list(self._stages).index(name)] = stage.address

    def link(self, arguments: Mapping[str, tuple[Any, ...]]) -> bool:
        """Load or compile stages and make the table usable in kernels; False if one of them is no kernel.

        Parameters
        ----------
        arguments : mapping of str to tuple
            By stage, values of the types that the loop passes. The other stages stay out: compiled code must not reach
            them.

        Raises
        ------
        TypeError
            If a stage returns anything.
        """
        is_compiled = True
        for name, stage in self._stages.items():
            if name not in arguments:
                continue
            if not isinstance(stage, BoundKernel):
                is_compiled = False
                continue
            self._link(name, stage, arguments[name])
        return is_compiled
