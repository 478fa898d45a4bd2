# SPDX-License-Identifier: GPL-3.0-or-later
"""Folders that take no file."""

from __future__ import annotations

import errno
from pathlib import Path
from typing import Any


def freeze(monkeypatch: Any, folder: Path) -> None:
    """Have a folder behave as on a file system that is mounted read-only."""
    for name in ("open", "unlink"):
        real = getattr(Path, name)

        def refuse(self: Path, *arguments: Any, _real: Any = real, **named: Any) -> Any:
            if folder in self.parents:
                raise OSError(errno.EROFS, "Read-only file system", str(self))
            return _real(self, *arguments, **named)

        monkeypatch.setattr(Path, name, refuse)
