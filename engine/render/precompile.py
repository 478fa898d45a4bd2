# SPDX-License-Identifier: GPL-3.0-or-later
"""Compiling kernels before they are needed, in helper processes.

Numba compiles one kernel at a time and cannot be interrupted while it does. Where the cache is cold, Python processes
of our own therefore compile a part each into the cache, while this one only waits: it can tell the user and be
cancelled. Where there is no Python to start, or a helper fails, kernels are compiled by their first call as ever.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path

import llvmlite.binding as llvm
import numba

from engine.processes.interpreter import find_interpreter
from engine.render.compile_progress import CompileClock, CompileProgress, Work, reported
from engine.runtime.kernel_cache import cache_root, made_with
from engine.runtime.kernel_library import engine_sources, kernel_library
from engine.runtime.sources import PACKAGE

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None  # type: ignore[assignment]

#: What helpers compile, about the same work each: the shader interpreter, and all other stages.
PARTS = ("shaders", "tracing")
#: What one more compiles for guided renders, with the others in place.
GUIDED_PARTS = ("guiding",)
#: And for renders with wavelengths.
SPECTRAL_PARTS = ("spectral",)
SPECTRAL_GUIDED_PARTS = ("spectral_guiding",)
#: What libraries made ahead hold too, and what is compiled by its first call where there is none: for all passes,
#: media, things that move, light below surfaces, curves and points, closures that few have, the radiance cache, what
#: learns, and trees.
AHEAD_PARTS = ("passes", "media", "motion", "subsurface", "curves", "closures", "cache", "learning", "fields")

#: What parts take, one after the other on a machine with nothing else to do: for telling how long it will take.
#: `tests/engine/render/test_precompile.py` compares the numbers of kernels.
WORK = {
    "shaders": Work(1, 20.0),
    "tracing": Work(26, 25.0),
    "guiding": Work(27, 22.0),
    "spectral": Work(19, 18.0),
    "spectral_guiding": Work(15, 17.0),
}

_POLL_SECONDS = 0.05

# Inside Blender the engine is a package within packages that are Blender's to make: stand-ins are enough.
_BOOTSTRAP = """
import importlib, json, sys, types
path, package, folder, part = json.loads(sys.argv[1])
sys.path[:] = path
parents = package.split(".")[:-1]
for depth in range(1, len(parents) + 1):
    module = types.ModuleType(".".join(parents[:depth]))
    module.__path__ = [folder] if depth == len(parents) else []
    sys.modules[module.__name__] = module
importlib.import_module(package + ".processes.parent").leave_with_input()
importlib.import_module(package + ".render.precompile_worker").compile_part(part)
"""


def count_file(part: str) -> Path:
    """File that grows by a byte with each kernel of `part` that is compiled."""
    return stamp_file(part).with_suffix(".count")


def stamp_file(part: str) -> Path:
    """File that says that `part` is in the cache, for these sources and this processor."""
    processor = llvm.get_host_cpu_name() + llvm.get_host_cpu_features().flatten()  # type: ignore[no-untyped-call]
    digest = hashlib.sha256((made_with(engine_sources()) + processor).encode()).hexdigest()[:16]
    return cache_root() / f"{part}-{digest}.complete"


def is_cold(parts: Sequence[str] = PARTS) -> bool:
    """Whether kernels are to be compiled before the first render."""
    library = kernel_library()
    if numba.config.DISABLE_JIT or (library is not None and library.parts.issuperset(parts)):
        return False
    return not all(stamp_file(part).is_file() for part in parts)


def compile_ahead(
    poll: Callable[[CompileProgress], None], *, is_guided: bool = False, is_spectral: bool = False
) -> None:
    """Fill the cache, if it is cold; does nothing where that is impossible.

    Parameters
    ----------
    poll : callable
        Called often with how far it is. What it raises ends the helpers and is raised again.
    is_guided : bool
        Whether the kernels of guiding are needed too.
    is_spectral : bool
        Whether paths have wavelengths: tracing has kernels of its own for them.
    """
    needed: list[tuple[str, ...]] = [PARTS]
    if is_guided:
        needed.append(GUIDED_PARTS)
    if is_spectral:
        needed.append(SPECTRAL_PARTS)
    if is_guided and is_spectral:
        needed.append(SPECTRAL_GUIDED_PARTS)
    steps = [tuple(part for part in parts if not stamp_file(part).is_file()) for parts in needed if is_cold(parts)]
    clock = CompileClock([{part: WORK[part] for part in parts} for parts in steps], os.cpu_count() or 1)
    for step, parts in enumerate(steps):
        _compile_parts(parts, partial(_tell, poll, clock, step, parts, time.monotonic()))


def _tell(
    poll: Callable[[CompileProgress], None], clock: CompileClock, step: int, parts: Sequence[str], started: float
) -> None:
    done = {
        part: WORK[part].kernels
        if stamp_file(part).is_file()
        # Before its stamp is there a part is not done, whatever it has compiled.
        else min(reported(count_file(part)), WORK[part].kernels - 1)
        for part in parts
    }
    poll(clock.progress(step, done, time.monotonic() - started))


def _compile_parts(parts: Sequence[str], poll: Callable[[], None]) -> None:
    python = find_interpreter()
    if python is None or not os.access(cache_root(), os.W_OK):
        return
    helpers: list[subprocess.Popen] = []
    try:
        with contextlib.suppress(OSError):
            helpers += [_start(python, part) for part in parts]
        while any(helper.poll() is None for helper in helpers):
            poll()
            time.sleep(_POLL_SECONDS)
    finally:
        for helper in helpers:
            if helper.poll() is None:
                helper.kill()
            helper.wait()
            if helper.stdin is not None:
                helper.stdin.close()


@contextlib.contextmanager
def exclusive(part: str) -> Iterator[None]:
    """Let only one process at a time compile `part` of these sources: others wait, then find it done."""
    with stamp_file(part).with_suffix(".lock").open("w", encoding="ascii") as file:
        if fcntl is not None:
            fcntl.flock(file, fcntl.LOCK_EX)
        yield  # closing the file frees the lock, as the end of the process does


def _start(python: str, part: str) -> subprocess.Popen:
    folder = Path(__file__).resolve().parents[2]
    arguments = json.dumps([sys.path, PACKAGE, str(folder), part])
    return subprocess.Popen(
        [python, "-I", "-S", "-B", "-c", _BOOTSTRAP, arguments],
        stdin=subprocess.PIPE,  # which ends with this process, and the helper with it
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        env={**os.environ, "NEURALGUIDE_KERNEL_CACHE": str(cache_root())},
        creationflags=getattr(subprocess, "CREATE_NO_WINDOW", 0),
    )
