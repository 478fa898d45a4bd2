# SPDX-License-Identifier: GPL-3.0-or-later
"""Which engine this is: sums of two engines must not meet in one picture."""

from __future__ import annotations

import hashlib
import sys
from functools import cache
from pathlib import Path

import numba
import numpy as np

_ENGINE = Path(__file__).resolve().parents[1]


@cache
def source_version() -> str:
    """Digest of all of the engine's sources and tables, and of what compiles them: 16 hexadecimal digits."""
    digest = hashlib.sha256(f"{sys.version_info[:2]}{numba.__version__}{np.__version__}".encode())
    for file in sorted(path for path in _ENGINE.rglob("*") if path.suffix in (".py", ".npz")):
        digest.update(file.relative_to(_ENGINE).as_posix().encode())
        digest.update(file.read_bytes())
    return digest.hexdigest()[:16]
