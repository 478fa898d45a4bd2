# SPDX-License-Identifier: GPL-3.0-or-later
"""A small engine of a few kernels, of which libraries are made in seconds, and a process that calls these kernels."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
LEVEL = "x86-64-v3"

#: Stands where the engine has what compiles its kernels: that is the module whose sources a library is made of.
_KERNELS = """
import ctypes
import math

import numpy as np

from engine.runtime.bundle import Bundle
from engine.runtime.jit import BoundKernel, kernel
from engine.runtime.stage_table import StageTable


class Numbers(Bundle):
    values: np.ndarray
    sums: np.ndarray


@kernel
def wave(values, out):
    for k in range(values.size):
        x = values[k]
        out[k] = math.sin(x) * x + math.exp(-x * x) - math.pow(abs(x), 0.3) / (1.0 + x * x)


@kernel
def pair(x):
    return 2 * x, x > 3, np.float32(x) * 0.5


@kernel(called_by_c=True)
def thrice(x):
    return 3 * x


@kernel
def add_up(numbers):
    for k in range(numbers.values.shape[0]):
        numbers.sums[0] += numbers.values[k] * numbers.values[k] + 0.1


@kernel
def loop(stages, numbers, count):
    for _ in range(count):
        stages.add_up(numbers)
    return True


def results():
    values = np.linspace(-3.0, 3.0, 1001, dtype=np.float32)
    out, sums = np.empty_like(values), np.zeros(1, np.float32)
    wave(values, out)
    numbers = Numbers(values, sums)
    stages = StageTable({"add_up": add_up})
    assert stages.link({"add_up": (numbers,)})
    bound = BoundKernel(loop)
    assert bound(stages, numbers, 3)
    called_by_c = BoundKernel(thrice)
    called_by_c.bind(0)
    by_c = ctypes.CFUNCTYPE(ctypes.c_int64, ctypes.c_int64)(called_by_c.c_address)(14)
    return out.tobytes().hex() + sums.tobytes().hex() + repr((pair(5), by_c))


def compile_part(part):
    results()
"""

#: Prints what the kernels give and where they came from.
_CALL = """
import sys
if {limit} >= 0:
    import resource
    resource.setrlimit(resource.RLIMIT_FSIZE, ({limit}, {limit}))
from {package}.runtime import kernel_cache, kernel_library
if {asks_for!r}:
    kernel_library.LEVELS[{level!r}] |= {{{asks_for!r}}}
from {package}.render.precompile_worker import results
print(results())
print(kernel_cache.describe_kernels())
print(kernel_cache.problem())
"""


def make_tree(folder: Path) -> Path:
    """Write the small engine into a folder; returns the folder."""
    package = folder / "engine"
    shutil.copytree(ROOT / "engine" / "runtime", package / "runtime", ignore=shutil.ignore_patterns("__pycache__"))
    shutil.copy(ROOT / "engine" / "__init__.py", package)
    (package / "render").mkdir()
    (package / "render" / "__init__.py").touch()
    (package / "render" / "precompile_worker.py").write_text(_KERNELS)
    return folder


def make_relative(tree: Path) -> None:
    """Make the small engine a part of a package, as it is in an extension: of whatever name the folder has."""
    (tree / "__init__.py").touch()
    for path in tree.rglob("*.py"):
        path.write_text(path.read_text().replace("from engine.", "from ...engine."))


def call_kernels(
    tree: Path, libraries: Path | str, cache: Path, *, level: str = "", limit: int = -1, asks_for: str = "",
    package: str = "engine",
) -> tuple[str, str, str]:
    """Call the kernels in a process of its own.

    Parameters
    ----------
    libraries : Path or str
        Folder of libraries, '' for none.
    cache : Path
        Folder of the kernel cache.
    level : str
        Processors that kernels are compiled for there; '': this one.
    limit : int
        Bytes that files may grow to, if it is not negative.
    asks_for : str
        A feature that no processor has and the level is to ask for.
    package : str
        What the engine is called, seen from the folder `tree`.

    Returns
    -------
    results, where the kernels came from, what is wrong with the cache : str
    """
    environment = {
        **os.environ, "PYTHONPATH": str(tree), "PYTHONDONTWRITEBYTECODE": "1", "NEURALGUIDE_KERNEL_CACHE": str(cache),
        "NEURALGUIDE_KERNEL_LIBRARIES": str(libraries),
    }  # fmt: skip
    if level:
        environment |= {"NUMBA_CPU_NAME": level, "NUMBA_CPU_FEATURES": ""}
    command = [sys.executable, "-c", _CALL.format(limit=limit, asks_for=asks_for, level=LEVEL, package=package)]
    done = subprocess.run(command, env=environment, cwd=tree, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    results, origins, problem = done.stdout.splitlines()
    return results, origins, problem
