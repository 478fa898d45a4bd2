# SPDX-License-Identifier: GPL-3.0-or-later
"""Kernel caches that lack a few kernels: what is done where some are missing, without compiling all for minutes."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

from engine.runtime.kernel_cache import cache_root

#: Modules of a first render whose kernels are compiled in no time, twelve in all.
QUICK_MODULES = ("accumulate", "film_sums", "play_roulette", "filters", "flattened", "light_tree", "clock")

_RENDER_ONCE = """
from engine.render.precompile_worker import compile_part
from engine.render.precompile import PARTS
for part in PARTS:
    compile_part(part)
"""


def cache_without(folder: Path, modules: tuple[str, ...]) -> Path:
    """Fill `folder` with what a first render needs, but for the kernels of `modules`; no part is called complete.

    What tests have compiled before is not compiled again: it is copied.
    """
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    subprocess.run([sys.executable, "-c", _RENDER_ONCE], env=environment, check=True, capture_output=True)
    missing = [f"{module}-*" for module in modules]
    shutil.copytree(cache_root(), folder, ignore=shutil.ignore_patterns("*.complete", "*.count", "*.lock", *missing))
    return folder
