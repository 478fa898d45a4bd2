# SPDX-License-Identifier: GPL-3.0-or-later
"""The command line, run in the test's own process."""

from __future__ import annotations

from pathlib import Path
from typing import Any


def run_here(monkeypatch: Any, *arguments: str) -> int:
    """Run the command line in this process, where the fake session can be seen."""
    from addon import engine
    from addon.__main__ import main

    monkeypatch.setattr(engine, "cancel_hooks", [])
    return main(arguments)


def names(folder: Path) -> list[str]:
    """Files of a folder, but for scenes."""
    return sorted(path.name for path in folder.iterdir() if not path.suffix.startswith(".blend"))
