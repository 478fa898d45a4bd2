# SPDX-License-Identifier: GPL-3.0-or-later
"""The one decorator every compiled function wears, and where its machine code is kept.

`kernel` differs from a bare `numba.njit` in these ways:

- a float literal in a kernel is float32 (numba would promote every expression it touches to float64);
- kernels do not allocate, so arrays are not reference counted (numba's counting is not always optimised away);
- room for what called functions return is not cleared first (`lowering.py`);
- other kernels call a twin without Python wrapper, machine code and cache file of its own;
- a wrapper by which C calls it is made for those kernels alone that a library calls;
- what operators do with numbers is found out once, not at each place where they are written (`inference.py`);
- numba's passes for what no kernel has are left out (`pipeline.py`), and its flags are compared once (`flags.py`);
- divisions follow IEEE (no Python exception, no hidden branch), fast-math never assumes away NaN or infinity;
- literal and int32 arguments do not make numba compile a callee anew (`_serve_callers`);
- numba hears of a kernel when it is first needed (`Kernel`): most of a process's kernels never are;
- it may have been compiled ahead of time, and what was compiled here is kept by the sources a kernel is made of,
  imports included (`kernel_cache.py`): numba's own cache does not see an edited callee in another file.
"""

from __future__ import annotations

import sys
import threading
from collections.abc import Callable, Mapping, Sequence
from functools import cache, update_wrapper
from inspect import signature
from types import FunctionType
from typing import Any

import numba
import numpy as np
from numba.core import sigutils, types
from numba.core.typing.typeof import typeof_impl

from engine.runtime.bounds import is_checked
from engine.runtime.flags import keep_flags
from engine.runtime.kernel_cache import KernelCache
from engine.runtime.pipeline import KernelCompiler

#: LLVM may contract, reassociate, use reciprocals and drop the sign of zero. It may not assume that NaN and infinity
#: never occur: rejects are counted by looking for them.
SAFE_FASTMATH = frozenset({"contract", "reassoc", "arcp", "nsz", "afn"})

class _ConstantTuple(tuple):
    """A tuple that numpy scalars do not compare with elementwise: numba compares constants with ==."""

    __slots__ = ()
    __array_ufunc__ = None


@typeof_impl.register(_ConstantTuple)
def _type_of_constant_tuple(value: Any, context: Any) -> Any:
    return typeof_impl(tuple(value), context)


def _float32_constants(value: Any) -> Any:
    if type(value) is float:
        return np.float32(value)
    if type(value) is tuple:
        return _ConstantTuple(_float32_constants(item) for item in value)
    return value


def call_type(argument: Any) -> Any:
    """Type by which an argument is passed to other kernels."""
    general = types.unliteral(argument)  # type: ignore[attr-defined]
    return types.int64 if general == types.int32 else general


def _serve_callers(dispatcher: Any, make_callee: Callable[[], Any]) -> Any:
    """Make calls from other kernels use the same function without what only Python needs.

    Numba would give every helper a Python wrapper, machine code and a file in the cache, all unused once it is inlined;
    and compile it, and all it calls, again for every value of a literal argument and for int32 beside int64.
    """
    keys: dict[Any, object] = {}
    # Made where something is compiled, which is nowhere if all was compiled before: there are hundreds.
    callee = cache(make_callee)

    def get_call_template(args: Any, kws: Any) -> Any:
        return callee().get_call_template(
            tuple(call_type(argument) for argument in args),
            {name: call_type(argument) for name, argument in kws.items()},
        )

    def get_overload(signature: Any) -> object:
        # Numba looks a callee up by its entry point, of which one without wrapper has none: give it a name.
        arguments, _returned = sigutils.normalize_signature(signature)
        if arguments not in keys:
            compiled = callee().overloads[arguments]
            keys[arguments] = object()
            compiled.target_context.insert_user_function(keys[arguments], compiled.fndesc, [compiled.library])
        return keys[arguments]

    dispatcher.get_call_template = get_call_template
    dispatcher.get_overload = get_overload
    return dispatcher


def _dispatcher(function: Any, options: dict[str, Any]) -> Any:
    dispatcher = numba.njit(**options)(function)
    dispatcher._compiler._customize_flags = keep_flags
    return dispatcher


class Kernel:
    """A function that numba compiles; its dispatcher is made when somebody calls it, binds it or asks for its type.

    There are hundreds of kernels, and where their callers were compiled before, numba need not know of them: making all
    dispatchers would take a quarter of the time that importing the engine takes.

    Parameters
    ----------
    function : callable
        The kernel, as Python.
    options : dict
        For `numba.njit`.

    Attributes
    ----------
    py_func : callable
        The kernel, as Python.
    """

    _making = threading.RLock()

    def __init__(self, function: Any, options: dict[str, Any]) -> None:
        self._options = options
        self._made: Any = None
        self.py_func = function
        update_wrapper(self, function)

    @property
    def is_made(self) -> bool:
        """Whether numba knows it."""
        return self._made is not None

    @property
    def dispatcher(self) -> Any:
        """Numba's dispatcher."""
        if self._made is None:
            with self._making:
                if self._made is None:
                    self._made = self._make()
        return self._made

    def _make(self) -> Any:
        function, options = self.py_func, self._options
        dispatcher = _dispatcher(function, options)
        dispatcher._cache = KernelCache(function)
        inlined = {**options, "no_cpython_wrapper": True, "no_cfunc_wrapper": True}
        return _serve_callers(dispatcher, lambda: _dispatcher(function, inlined))

    @property
    def _numba_type_(self) -> Any:
        return self.dispatcher._numba_type_

    def __call__(self, *arguments: Any) -> Any:
        return self.dispatcher(*arguments)

    def __getattr__(self, name: str) -> Any:
        # Special methods are asked for by whoever looks at an object, and none of numba's is needed there.
        if name.startswith("__"):
            raise AttributeError(name)
        return getattr(self.dispatcher, name)


def kernel(
    function: Callable[..., Any] | None = None,
    *,
    forceinline: bool = False,
    fastmath: frozenset[str] | bool = SAFE_FASTMATH,
    float64_literals: bool = False,
    called_by_c: bool = False,
) -> Any:
    """Compile a function with numba; see the module's docstring for what differs from `numba.njit`.

    Parameters
    ----------
    function : callable
        Plain Python over scalars, tuples and arrays; it must not raise.
    forceinline : bool
        Ask LLVM to inline every call: for helpers that take many arrays and are called from one or two places.
    fastmath : set of str or bool
        LLVM fast-math flags, if `SAFE_FASTMATH` does not suit.
    float64_literals : bool
        Leave float literals double: for the few kernels that accumulate in float64.
    called_by_c : bool
        Whether `BoundKernel.c_address` is asked for.
    """

    def decorate(target: Callable[..., Any]) -> Any:
        if not float64_literals:
            code = target.__code__
            target.__code__ = code.replace(co_consts=tuple(_float32_constants(value) for value in code.co_consts))
        options = {
            "nogil": True,
            "error_model": "numpy",
            "fastmath": set(fastmath) if isinstance(fastmath, frozenset) else fastmath,
            "forceinline": forceinline,
            "boundscheck": is_checked,
            # No allocation in kernels, so no reference counting: it was most of the code.
            "_nrt": False,
            "no_cfunc_wrapper": not called_by_c,
            "pipeline_class": KernelCompiler,
        }
        return numba.njit(**options)(target) if numba.config.DISABLE_JIT else Kernel(target, options)

    return decorate if function is None else decorate(function)


def by_bundle(kernels: Mapping[type, Any] | Callable[[str], Any], argument: int = 0, like: Any = None) -> Any:
    """A kernel that stands for several with the same arguments: which one, the class of a bundle among them decides.

    The choice is made when a caller is compiled, and costs nothing.

    Parameters
    ----------
    kernels : mapping of bundle class to kernel, or callable (name of the class) -> kernel
    argument : int
        Position of the bundle that decides.
    like : kernel, optional
        One of them, where they are not listed.
    """
    if callable(kernels):
        choose, example = kernels, like
    else:
        by_name = {cls.__name__: chosen for cls, chosen in kernels.items()}
        choose, example = by_name.__getitem__, next(iter(by_name.values()))
    if numba.config.DISABLE_JIT:
        return lambda *arguments: choose(type(arguments[argument]).__name__)(*arguments)
    dispatcher = numba.njit(example.py_func)
    dispatcher.get_call_template = lambda args, kws: choose(args[argument].class_name).get_call_template(args, kws)

    def get_overload(signature: Any) -> object:
        arguments, _returned = sigutils.normalize_signature(signature)
        return choose(arguments[argument].class_name).get_overload(signature)

    dispatcher.get_overload = get_overload
    return dispatcher


def by_number(kernels: Mapping[int, Any], name: str, module: str) -> Any:
    """A kernel that stands for several with the same arguments: which one, a number before these arguments decides.

    It is written as a chain of comparisons in the mapping's order; numbers in a row that share a kernel share its call,
    and the last kernel takes every number that is left. It is inlined: call it from one place. So a table of kernels
    costs what a chain written by hand does.

    Parameters
    ----------
    name, module : str
        What the kernel is called, and the `__name__` of the module that calls it so.
    """
    runs: list[tuple[Any, list[int]]] = []
    for number, chosen in kernels.items():
        if runs and runs[-1][0] is chosen:
            runs[-1][1].append(number)
        else:
            runs.append((chosen, [number]))
    example = getattr(runs[0][0], "py_func", runs[0][0])
    arguments = ", ".join(signature(example).parameters)
    lines = [f"def {name}(number, {arguments}):"]
    for index, (_chosen, numbers) in enumerate(runs[:-1]):
        lines.append(f"    if {' or '.join(f'number == {number}' for number in numbers)}:")
        lines.append(f"        return kernel_{index}({arguments})")
    lines.append(f"    return kernel_{len(runs) - 1}({arguments})")
    namespace: dict[str, Any] = {f"kernel_{index}": chosen for index, (chosen, _numbers) in enumerate(runs)}
    return written_kernel(name, lines, namespace | {"__name__": module}, forceinline=True)


def written_kernel(name: str, lines: Sequence[str], names: Mapping[str, Any], **options: Any) -> Any:
    """A kernel of source that was written by a program, from a table.

    Parameters
    ----------
    name : str
        The function that the source defines.
    names : mapping
        What the source may name, and the `__name__` of the module that it belongs to.
    **options
        As `kernel` takes them.
    """
    namespace = dict(names)
    file = str(sys.modules[namespace["__name__"]].__file__)
    exec(compile("\n".join(lines), file, "exec"), namespace)
    return kernel(namespace[name], **options)


class BoundKernel:
    """A kernel for callers that pass arguments of the same types every time.

    Numba looks at the types of all arguments at every call, in Python for bundles and holding the GIL; a bound kernel
    does so at the first call only.
    """

    def __init__(self, dispatcher: Any) -> None:
        self._dispatcher = dispatcher
        self._entry: Callable[..., Any] | None = None
        self._compiled: Any = None

    def __call__(self, *arguments: Any) -> Any:
        if self._entry is None:
            self.bind(*arguments)
            assert self._entry is not None
        return self._entry(*arguments)

    def bind(self, *arguments: Any) -> None:
        """Load or compile the kernel for arguments of these types, without calling it."""
        argument_types = tuple(self._dispatcher.typeof_pyval(argument) for argument in arguments)
        self._entry = self._dispatcher.compile(argument_types)
        self._compiled = self._dispatcher.overloads[argument_types]

    @property
    def is_bound(self) -> bool:
        """Whether it was called or bound."""
        return self._entry is not None

    @property
    def signature(self) -> Any:
        """Numba's signature of a bound kernel."""
        return self._compiled.signature

    @property
    def address(self) -> int:
        """Where a bound kernel's machine code is, in numba's calling convention."""
        return self._compiled.library.get_pointer_to_function(self._compiled.fndesc.llvm_func_name)

    @property
    def c_address(self) -> int:
        """Where C calls a bound kernel that was made with `called_by_c`."""
        return self._compiled.library.get_pointer_to_function(self._compiled.fndesc.llvm_cfunc_wrapper_name)


def in_python(dispatcher: Any, *others: Any) -> Callable[..., Any]:
    """A kernel as the Python it was made from, and so the kernels that it calls of its own module and of `others`'."""
    functions = [getattr(one, "py_func", one) for one in (*others, dispatcher)]
    modules = {function.__module__ for function in functions}
    plain = {name: value for function in functions for name, value in function.__globals__.items()}
    module = {
        name: value
        for name, value in plain.items()
        if getattr(getattr(value, "py_func", None), "__module__", None) in modules
    }
    for name, value in module.items():
        plain[name] = FunctionType(value.py_func.__code__, plain, name)
    function = functions[-1]
    return FunctionType(function.__code__, plain, function.__name__, function.__defaults__)
