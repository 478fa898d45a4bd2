# SPDX-License-Identifier: GPL-3.0-or-later
"""Kernels compiled ahead of time: a shared library for a level of processors, and the index that says what is in it.

`tools/kernel_library.py` makes both when the extension is built. They are read where they lie, and nothing is written.
A library is used if it was made of these very sources, for this Python and this numba, and if the processor has all
that its level asks for, and nobody but this user and root could have written it. In any other case `problem` says what
does not fit, and kernels come from the cache or are compiled here.

The library holds numba's own machine code of each kernel and its wrapper for Python, and depends on no other library:
Python's functions are found in the process, and all else is called through a table of addresses (`SLOTS`), which is
filled with what the same names mean to numba's compiler here. So kernels call the same mathematical functions and the
same Embree as those that are compiled here.
"""

from __future__ import annotations

import ctypes
import hashlib
import json
import os
import platform
import sys
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import llvmlite
import llvmlite.binding as llvm
import numba
from numba import _dynfunc, types
from numba.core.compiler import CompileResult
from numba.core.environment import Environment
from numba.core.typing import signature

from engine.runtime.bounds import is_checked
from engine.runtime.sources import PACKAGE, ROOT, hash_of, reached_files, source_hash
from engine.runtime.trusted_files import read_trusted, weakness

#: Version of the two files' form.
FORMAT = 3
#: What the library calls the table of addresses, and, where it cannot ask for Python's data by name, pointers to them.
SLOTS = "neuralguide_slots"
_POINTER = "__imp_"
#: What libraries are called, by system.
_SUFFIXES = {"win32": ".dll", "darwin": ".dylib"}
#: Where libraries lie; the environment may name another folder, or '' for none.
FOLDER = ROOT / "compiled"
FOLDER_VARIABLE = "NEURALGUIDE_KERNEL_LIBRARIES"

_V3 = "avx avx2 bmi bmi2 cx16 f16c fma lzcnt movbe popcnt sahf sse sse2 sse3 sse4.1 sse4.2 ssse3 xsave"
#: What processors of a level have, by LLVM's names of level and features; the level that asks for most comes first.
LEVELS = {
    "x86-64-v4": frozenset(f"{_V3} avx512bw avx512cd avx512dq avx512f avx512vl".split()),
    "x86-64-v3": frozenset(_V3.split()),
    # All processors of macOS on ARM have it.
    "apple-m1": frozenset(),
}


@dataclass(frozen=True)
class _Descriptor:
    """What numba asks of a function that is compiled: `FunctionDescriptor` without what only its compiler needs."""

    llvm_func_name: str
    llvm_cfunc_wrapper_name: str
    restype: Any
    argtypes: tuple[Any, ...]
    qualname: str


_WORKER = f"{PACKAGE}.render.precompile_worker", ROOT / "render" / "precompile_worker.py"


def engine_sources() -> str:
    """Hash of all sources that kernels are made of: those that the process that compiles them reaches."""
    return source_hash(*_WORKER)


def source_files() -> list[str]:
    """These sources, below the engine's folder.

    An index lists them, so that whoever opens its library need not find out: one more would be imported by one of them,
    which would be another then.
    """
    return [path.relative_to(ROOT).as_posix() for path in reached_files(*_WORKER)]


def made_for(files: Iterable[str]) -> dict[str, object]:
    """What a library of these sources must have been made for to be used here, but for the processor."""
    try:
        sources = hash_of(ROOT / name for name in files)
    except OSError:
        sources = "without some of them"
    return {
        "form": FORMAT,
        "system": f"{sys.platform} on {platform.machine()}",
        "Python": f"{sys.version_info.major}.{sys.version_info.minor}",
        "numba": numba.__version__,
        "llvmlite": llvmlite.__version__,
        "sources": sources,
    }


class KernelLibrary:
    """One opened library.

    Parameters
    ----------
    index : Path
        The library's index; the library lies beside it.

    Raises
    ------
    ValueError
        Saying why it cannot be used here.
    OSError
        If a file is missing or cannot be read.
    """

    def __init__(self, index: Path) -> None:
        if why := weakness(index.parent):
            raise ValueError(why)
        header, _, body = _read(index).partition(b"\n")
        try:
            facts = json.loads(header)
            made, level, parts, files = facts["made_for"], facts["level"], facts["parts"], facts["files"]
            slots, pointers, library_digest = facts["slots"], facts["pointers"], facts["library"]
            is_whole = _digest(body) == facts["index"]
        except (KeyError, TypeError, UnicodeDecodeError, json.JSONDecodeError):
            is_whole = False
        if not is_whole:
            raise ValueError("its index is damaged")
        for what, ours in made_for(files).items():
            if made.get(what) != ours:
                raise ValueError(f"made for {what} {made.get(what)}, and here is {ours}")
        if numba.config.CPU_NAME not in (None, level):
            raise ValueError(f"NUMBA_CPU_NAME asks for {numba.config.CPU_NAME}")
        if lacking := lacking_features(level):
            raise ValueError(f"this processor has no {', '.join(lacking)}")
        self.level: str = level
        #: What of the names in `engine.render.precompile` it holds whole.
        self.parts: frozenset[str] = frozenset(parts)
        self._entries: dict[str, list[Any]] = json.loads(body)
        file = index.with_suffix(_SUFFIXES.get(sys.platform, ".so"))
        if _digest(_read(file)) != library_digest:
            raise ValueError("the library is damaged")
        self._library = ctypes.CDLL(str(file))
        table = (ctypes.c_void_p * len(slots)).in_dll(self._library, SLOTS)
        for position, name in enumerate(slots):
            table[position] = _address_of(name)
        for name in pointers:
            ctypes.c_void_p.in_dll(self._library, _POINTER + name).value = _address_of(name)
        self._environments: list[Environment] = []

    def __len__(self) -> int:
        return len(self._entries)

    def get_pointer_to_function(self, name: str) -> int:
        """Address of a kernel's machine code, by which numba asks its own libraries too."""
        return ctypes.cast(getattr(self._library, name), ctypes.c_void_p).value or 0

    def load(self, key: str, function: Any, argument_types: tuple[Any, ...], target_context: Any) -> Any:
        """A kernel as numba's compiler would give it; None if the library does not have it.

        Parameters
        ----------
        key : str
            As `kernel_key` gives it.
        function : callable
            The kernel, as Python.
        argument_types : tuple of numba types
        target_context : numba's target
        """
        entry = self._entries.get(key)
        if entry is None:
            return None
        # The last of the names is there only where C calls the kernel.
        name, wrapper, environment_name, *c_names, returned = entry
        environment = Environment(function.__globals__)
        environment.env_name = environment_name
        # The machine code knows its address.
        self._environments.append(environment)
        ctypes.c_void_p.in_dll(self._library, environment_name).value = id(environment)
        return_type = read_type(returned)
        described = _Descriptor(name, "".join(c_names), return_type, argument_types, function.__qualname__)
        entry_point = _dynfunc.make_function(
            sys.modules[function.__module__], function.__name__, "", self.get_pointer_to_function(wrapper),
            environment, (self,),
        )
        return CompileResult(
            typing_context=target_context.typing_context, target_context=target_context, entry_point=entry_point,
            typing_error=None, type_annotation="", signature=signature(return_type, *argument_types), library=self,
            call_helper=None, environment=environment, lifted=(), fndesc=described, objectmode=False, metadata=None,
            reload_init=(), referenced_envs=(),
        )


def _address_of(name: str) -> int:
    """What a name means to numba's compiler in this process."""
    address: int | None = llvm.address_of_symbol(name)  # type: ignore[no-untyped-call]
    if not address:
        raise ValueError(f"there is no {name} in this process")
    return address


def _read(file: Path) -> bytes:
    file.stat()  # Raises where there is none.
    data = read_trusted(file)
    if data is None:
        raise ValueError(f"{file} can be written by others")
    return data


def _digest(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()


def kernel_key(function: Any, argument_types: tuple[Any, ...]) -> str:
    """What a kernel (as Python) for certain arguments is called in an index, whose kernels are all of the same sources.
    """
    code = function.__code__
    # Functions made by other functions of the same sources differ in what they enclose.
    closure = repr([cell.cell_contents for cell in function.__closure__ or ()])
    module = function.__module__.removeprefix(PACKAGE)
    parts = (module, function.__qualname__, str(code.co_firstlineno), repr(argument_types), closure)
    return hashlib.sha256("\0".join(parts).encode() + code.co_code).hexdigest()[:32]


def lacking_features(level: str) -> list[str]:
    """What a level of processors has and this one has not, by LLVM's names; [level] if nobody knows the level."""
    if level not in LEVELS:
        return [level]
    features = llvm.get_host_cpu_features()  # type: ignore[no-untyped-call]
    return sorted(name for name in LEVELS[level] if not features.get(name))


def write_type(typ: Any) -> Any:
    """A type that kernels return, for the index; None for one that this does not know."""
    typ = types.unliteral(typ)  # type: ignore[attr-defined]
    if typ == types.none or isinstance(typ, types.Number | types.Boolean):
        return typ.name
    if isinstance(typ, types.UniTuple | types.Tuple):
        written = [write_type(item) for item in typ.types]
        return None if None in written else written
    return None


def read_type(written: Any) -> Any:
    """The type that `write_type` wrote."""
    if isinstance(written, list):
        return types.Tuple(tuple(read_type(item) for item in written))
    return types.boolean if written == "bool" else getattr(types, written)


class _Opened:
    """The library of this process, if there is one, and what is to be said of those that are not used."""

    def __init__(self) -> None:
        self.library: KernelLibrary | None = None
        self.problems: list[str] = []
        named = os.environ.get(FOLDER_VARIABLE)
        if numba.config.DISABLE_JIT or is_checked or named == "":
            return
        folder = Path(named) if named else FOLDER
        tag = f"py{sys.version_info.major}{sys.version_info.minor}"
        for level in LEVELS:
            index = folder / f"{tag}-{level}.index"
            if not index.is_file():
                continue
            try:
                self.library = KernelLibrary(index)
            except (ValueError, OSError) as error:
                self.problems.append(f"{index.stem}: {getattr(error, 'strerror', None) or error}")
            else:
                return


@cache
def _opened() -> _Opened:
    return _Opened()


def kernel_library() -> KernelLibrary | None:
    """The library that this process uses, None if none fits."""
    return _opened().library


def problem() -> str:
    """Why kernels that were compiled ahead are not used; '' if they are, or there are none."""
    opened = _opened()
    return "" if opened.library is not None else "; ".join(opened.problems)
