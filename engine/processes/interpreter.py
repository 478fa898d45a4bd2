# SPDX-License-Identifier: GPL-3.0-or-later
"""Which Python to start: Blender is a program with Python inside."""

from __future__ import annotations

import sys
from pathlib import Path


def find_interpreter() -> str | None:
    """A Python to start: this process's own unless that is a program with Python inside, None if there is none."""
    version = f"python{sys.version_info.major}.{sys.version_info.minor}"
    prefix = Path(sys.prefix)
    for candidate in (Path(sys.executable or ""), prefix / "bin" / version, prefix / "bin" / "python.exe"):
        if candidate.stem.lower().startswith("python") and candidate.is_file():
            return str(candidate)
    return None
