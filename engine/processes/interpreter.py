# SPDX-License-Identifier: GPL-3.0-or-later
"""Which Python to start: Blender is a program with Python inside."""

from __future__ import annotations

import sys
from pathlib import Path


def find_interpreter() -> str | None:
    """The Python of this process as a program of its own, None if there is none.

    `sys.executable` may be Blender, or another Python that happens to be found first: only one that lies where this
    process's Python is at home is sure to be the same.
    """
    version = f"python{sys.version_info.major}.{sys.version_info.minor}"
    prefix = Path(sys.prefix)
    candidates = [prefix / "bin" / version, prefix / "bin" / "python.exe"]
    own = Path(sys.executable or "")
    candidates.insert(0 if own.is_relative_to(prefix) else len(candidates), own)
    for candidate in candidates:
        if candidate.stem.lower().startswith("python") and candidate.is_file():
            return str(candidate)
    return None
