# SPDX-License-Identifier: GPL-3.0-or-later
"""Where the kernels' machine code is kept, and what happens where it cannot be.

A cache must never be what breaks a render. A folder that cannot be written is replaced by a temporary one, a disk that
is full leaves kernels in memory, and a damaged file counts as missing; `problem` says so for the user to be told.
"""

from __future__ import annotations

import atexit
import contextlib
import os
import shutil
import tempfile
from functools import cache
from pathlib import Path
from typing import Any

from numba.core import caching, config

#: What went wrong, in words; empty if nothing did.
_problems: list[str] = []
#: Set in a helper process, whose work is for nothing where it cannot be saved: it ends with the error.
must_save = False
_is_saving = True


def chosen_root() -> Path:
    """Folder that is asked for: `NEURALGUIDE_KERNEL_CACHE`, else one in the user's cache folder."""
    chosen = os.environ.get("NEURALGUIDE_KERNEL_CACHE")
    if chosen:
        return Path(chosen)
    base = os.environ.get("XDG_CACHE_HOME") or os.environ.get("LOCALAPPDATA")
    if not base:
        try:
            base = str(Path.home() / ".cache")
        except RuntimeError:  # nobody's home
            base = tempfile.gettempdir()
    return Path(base) / "neuralguide" / "kernels"


def cache_root() -> Path:
    """Folder of compiled kernels: the chosen one, or a temporary one for this process where that cannot be written."""
    return _usable(chosen_root())


def problem() -> str:
    """What is wrong with the cache, '' if nothing is."""
    return _problems[0] if _problems else ""


def _reason(error: OSError) -> str:
    return error.strerror or type(error).__name__


@cache
def _usable(chosen: Path) -> Path:
    try:
        chosen.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=chosen) as file:
            file.write(b"\0")
        return chosen
    except OSError as error:
        reason = _reason(error)
    with contextlib.suppress(OSError):
        if any(chosen.glob("*.complete")):
            return chosen  # somebody else filled it: enough to read
    _problems.append(f"cannot write to {chosen} ({reason})")
    try:
        folder = tempfile.mkdtemp(prefix="neuralguide-kernels-")
    except OSError:
        return chosen  # every attempt to save will fail, and kernels live in memory
    process = os.getpid()
    atexit.register(lambda: shutil.rmtree(folder, ignore_errors=True) if os.getpid() == process else None)
    return Path(folder)


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


class KernelCache(caching.FunctionCache):
    """Numba's cache of one kernel, for which a failure to read or write is no error.

    Parameters
    ----------
    function : callable
        The kernel, as Python.
    folder : Path
        Where its machine code belongs, and that of no other sources.
    """

    _impl_class = _Implementation

    def __init__(self, function: Any, folder: Path) -> None:
        previous = config.CACHE_DIR
        config.CACHE_DIR = str(folder)
        try:
            super().__init__(function)
        finally:
            config.CACHE_DIR = previous

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """What was saved for a signature; None, so that it is compiled, if nothing was or it is damaged."""
        try:
            return super().load_overload(sig, target_context)
        except Exception:
            # A file cut short by a crash: unpickling may raise anything. Saving would stumble over it too.
            with contextlib.suppress(OSError):
                os.unlink(self._cache_file._index_path)
            return None

    def save_overload(self, sig: Any, data: Any) -> None:
        """Save, unless that fails; after a failure this process does not try again."""
        global _is_saving
        if not _is_saving:
            return
        try:
            os.makedirs(self.cache_path, exist_ok=True)
            super().save_overload(sig, data)
        except OSError as error:
            if must_save:
                raise
            _is_saving = False
            _problems.append(f"cannot save to {cache_root()} ({_reason(error)})")
