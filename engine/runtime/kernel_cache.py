# SPDX-License-Identifier: GPL-3.0-or-later
"""Where the kernels' machine code comes from and is kept, and what happens where it cannot be.

A cache must never be what breaks a render. A folder that cannot be written is replaced by a temporary one, a disk that
is full leaves kernels in memory, and a damaged file counts as missing; `problem` says so for the user to be told.
Nor must it be how others have their code run here: a folder that somebody else may write to is replaced as well
(`trusted_files`).
"""

from __future__ import annotations

import atexit
import contextlib
import errno
import hashlib
import os
import pickle
import shutil
import sys
import tempfile
from collections import Counter
from collections.abc import Callable
from functools import cache, cached_property
from pathlib import Path
from typing import Any

import numba
import numpy as np
from numba.core import caching, config, sigutils
from numba.core.serialize import dumps

from engine.runtime.bounds import is_checked
from engine.runtime.kernel_library import kernel_key, kernel_library
from engine.runtime.kernel_library import problem as library_problem
from engine.runtime.sources import PACKAGE, source_hash
from engine.runtime.trusted_files import make_folder, read_trusted, weakness, write_trusted

#: What went wrong, in words; empty if nothing did.
_problems: list[str] = []
#: Set in a helper process, whose work is for nothing where it cannot be saved: it ends with the error.
must_save = False
_is_saving = True
#: How many kernels of this process came from where: 'library', 'cache', 'compiled'.
origins: Counter[str] = Counter()
#: Called with the key and numba's result of each kernel that is compiled here, where a library is made.
on_compiled: Callable[[str, Any], None] | None = None


#: Names the folder to keep kernels in.
_VARIABLE = "NEURALGUIDE_KERNEL_CACHE"


def chosen_root() -> Path | None:
    """Folder that is asked for: `NEURALGUIDE_KERNEL_CACHE`, else one in the user's cache folder; None without a home.
    """
    chosen = os.environ.get(_VARIABLE)
    if chosen:
        return Path(chosen)
    base = os.environ.get("XDG_CACHE_HOME") or os.environ.get("LOCALAPPDATA")
    if not base:
        try:
            base = str(Path.home() / ".cache")
        except RuntimeError:  # nobody's home, as in containers
            return None
    return Path(base) / "neuralguide" / "kernels"


def cache_root() -> Path:
    """Folder of compiled kernels: the chosen one, or a temporary one for this process where that cannot be used."""
    return _usable(chosen_root())


def problem() -> str:
    """What is wrong with the cache, '' if nothing is."""
    return _problems[0] if _problems else ""


def describe_kernels() -> str:
    """Where the kernels of this process came from, in words, and why none came from a library where one lies ready."""
    library = kernel_library()
    sources = {
        "library": f"made ahead for {library.level}" if library is not None else "",
        "cache": "from the cache",
        "compiled": "compiled here",
    }
    parts = [f"{origins[origin]} {words}" for origin, words in sources.items() if origins[origin]]
    said = f"kernels: {', '.join(parts) or 'none'}"
    return f"{said}; those made ahead are not used: {library_problem()}" if library_problem() else said


def _reason(error: OSError) -> str:
    return error.strerror or type(error).__name__


@cache
def _usable(chosen: Path | None) -> Path:
    if chosen is None:
        _problems.append(f"this user has no home folder: {_VARIABLE} may name one to keep kernels in")
        return _temporary() or Path(tempfile.gettempdir())
    try:
        make_folder(chosen)
        if why := weakness(chosen):
            _problems.append(f"cannot use {chosen}: {why}")
            return _temporary() or chosen
        with tempfile.TemporaryFile(dir=chosen) as file:
            file.write(b"\0")
        return chosen
    except OSError as error:
        reason = _reason(error)
    with contextlib.suppress(OSError):
        if any(chosen.glob("*.complete")) and not weakness(chosen):
            return chosen  # somebody else filled it: enough to read
    _problems.append(f"cannot write to {chosen} ({reason})")
    return _temporary() or chosen


def _temporary() -> Path | None:
    """A folder of this user that goes with this process, for those that it starts too; None if there can be none.

    Every attempt to save fails then, and kernels live in memory.
    """
    try:
        folder = tempfile.mkdtemp(prefix="neuralguide-kernels-")
    except OSError:
        return None
    os.environ[_VARIABLE] = folder
    process = os.getpid()
    atexit.register(lambda: shutil.rmtree(folder, ignore_errors=True) if os.getpid() == process else None)
    return Path(folder)


def made_with(sources: str) -> str:
    """What makes kernels of sources, by their hash, what they are.

    What is saved refers to classes of ours by the package's name.
    """
    return f"{PACKAGE}{sys.version_info[:2]}{numba.__version__}{np.__version__}{is_checked}{sources}"


class _Locator(caching.UserProvidedCacheLocator):
    """The folder `numba.config.CACHE_DIR` itself, whether or not it can be written.

    Numba would go on to a folder beside the sources, where its cache does not notice an edited callee. Its own key, the
    file's path and date, would compile all again for sources that were moved, or unpacked anew; ours is in the folder's
    name.
    """

    def __init__(self, py_func: Any, py_file: str) -> None:
        self._py_file = py_file
        self._lineno = py_func.__code__.co_firstlineno
        self._cache_path = config.CACHE_DIR

    def ensure_cache_path(self) -> None:
        pass

    def get_source_stamp(self) -> str:
        return ""


class _Implementation(caching.CompileResultCacheImpl):
    _locator_classes = (_Locator,)


class KernelCache(caching.NullCache):
    """Where a kernel's machine code comes from, if it need not be compiled: the library made ahead, else the cache.

    The cache is numba's, for which a failure to read or write is no error here. Sources are hashed when the kernel is
    first needed: most kernels are only called by others.

    Parameters
    ----------
    function : callable
        The kernel, as Python.
    """

    def __init__(self, function: Any) -> None:
        self._function = function

    @cached_property
    def _sources(self) -> str:
        return source_hash(self._function.__module__, Path(self._function.__code__.co_filename))

    @cached_property
    def _saved(self) -> _SavedKernels:
        digest = hashlib.sha256(made_with(self._sources).encode()).hexdigest()[:16]
        return _SavedKernels(self._function, cache_root() / f"{self._function.__module__.rpartition('.')[2]}-{digest}")

    @property
    def cache_path(self) -> str:
        """The kernel's folder in the cache."""
        path: str = self._saved.cache_path
        return path

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """What was compiled before for a signature; None, so that it is compiled, if nothing was or it is damaged."""
        library = kernel_library()
        if library is not None:
            arguments, _returned = sigutils.normalize_signature(sig)
            key = kernel_key(self._function, arguments)
            compiled = library.load(key, self._function, arguments, target_context)
            if compiled is not None:
                origins["library"] += 1
                return compiled
        compiled = self._saved.load_overload(sig, target_context)
        origins["cache" if compiled is not None else "compiled"] += 1
        return compiled

    def save_overload(self, sig: Any, data: Any) -> None:
        """Save what was compiled."""
        if on_compiled is not None:
            on_compiled(kernel_key(self._function, tuple(data.signature.args)), data)
        self._saved.save_overload(sig, data)


class _Files:
    """Files of one kernel, one for each of its signatures, each after its own digest: machine code with one bit wrong
    ends the process.

    Numba numbers such files and keeps the numbers in an index. Processes that save at the same time take the same
    number, and one then runs what the other has compiled for arguments of other types. Here the signature is the name.
    """

    def __init__(self, folder: Path, base: str) -> None:
        self._folder, self._base = folder, base

    def path(self, key: Any) -> Path:
        """Where the machine code for `key` lies, whose parts are told apart by what they are called."""
        return self._folder / f"{self._base}.{_digest(repr(key).encode()).hex()[:16]}.nbc"

    def load(self, key: Any) -> Any:
        """What was saved; None if nothing was, or it is damaged, or somebody else may have written it."""
        stored = read_trusted(self.path(key)) or b""
        digest, body = stored[:_DIGEST_SIZE], stored[_DIGEST_SIZE:]
        return pickle.loads(body) if body and _digest(body) == digest else None

    def save(self, key: Any, data: Any) -> None:
        """Save it."""
        body = dumps(data)
        write_trusted(self.path(key), _digest(body) + body)


def _digest(data: bytes) -> bytes:
    return hashlib.sha256(data).digest()


_DIGEST_SIZE = len(_digest(b""))


class _SavedKernels(caching.FunctionCache):
    """Numba's cache of one kernel, in a folder of no other sources."""

    _impl_class = _Implementation

    def __init__(self, function: Any, folder: Path) -> None:
        previous = config.CACHE_DIR
        config.CACHE_DIR = str(folder)
        try:
            super().__init__(function)
        finally:
            config.CACHE_DIR = previous
        self._cache_file = _Files(folder, self._impl.filename_base)

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """What was saved for a signature; None if nothing was or it is damaged."""
        try:
            return super().load_overload(sig, target_context)
        except Exception:
            # What is whole may still be of no use. It is compiled again, and saved in its place.
            return None

    def save_overload(self, sig: Any, data: Any) -> None:
        """Save, unless that fails; after a failure this process does not try again."""
        global _is_saving
        if not _is_saving:
            return
        try:
            folder = Path(self.cache_path)
            make_folder(folder)
            if why := weakness(folder):
                raise PermissionError(errno.EACCES, why)
            super().save_overload(sig, data)
        except OSError as error:
            if must_save:
                raise
            _is_saving = False
            _problems.append(f"cannot save to {cache_root()} ({_reason(error)})")
