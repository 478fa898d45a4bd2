# SPDX-License-Identifier: GPL-3.0-or-later
"""A process that has Python compile what a render loads to byte code, once after an installation.

Wheels and zips bring none, and Python compiles a module when it is first imported, which is most of the time to the
first picture. What this writes is what Python itself would write then, to the same places.
"""

from __future__ import annotations

import compileall
import importlib
from importlib.util import cache_from_source
from pathlib import Path
from typing import Any, BinaryIO, TextIO

from engine.processes.parent import leave_with_parent

_ENGINE = __package__.rpartition(".")[0]
_ROOT = Path(__file__).resolve().parents[1]
_LAST = "loaded_whole"


def serve(config: dict[str, Any], _stream: BinaryIO, _answers: TextIO) -> None:
    """Compile the sources beside this one, then load the engine with the packages that it needs."""
    leave_with_parent(config)
    last = Path(__file__).with_name(f"{_LAST}.py")
    # Whoever renders meanwhile begins with the packages.
    for folder in (_ROOT, _ROOT.parent / "addon"):
        for path in sorted(folder.rglob("*.py")):
            if path != last and not Path(cache_from_source(str(path))).is_file():
                compileall.compile_file(path, quiet=2)
    importlib.import_module(f"{_ENGINE}.render.session")
    importlib.import_module(f"{_ENGINE}.render.{_LAST}")
