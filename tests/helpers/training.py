# SPDX-License-Identifier: GPL-3.0-or-later
"""What tests of training share."""

from __future__ import annotations

import subprocess
import sys
from typing import Any

import pytest

from engine.guiding.neural.trainer import standby
from engine.processes.child import ENTRY


def require_torch() -> Any:
    """The module torch; where it is not installed, the test (or the file) that asks is skipped."""
    lock = f"requirements-{sys.version_info.major}.{sys.version_info.minor}.lock"
    return pytest.importorskip("torch", reason=f"this trains networks, and torch is not installed: see {lock}")


def refuse_workers(monkeypatch: pytest.MonkeyPatch) -> None:
    """Have the system start no training workers: OSError, 'no process'. None stands by either."""
    standby.dismiss()

    class Popen(subprocess.Popen):  # type: ignore[type-arg]
        def __init__(self, command: Any, *arguments: Any, **options: Any) -> None:
            if str(command[-1]) == str(ENTRY):
                raise OSError("no process")
            super().__init__(command, *arguments, **options)

    monkeypatch.setattr(subprocess, "Popen", Popen)
