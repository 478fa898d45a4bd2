# SPDX-License-Identifier: GPL-3.0-or-later
"""Where messages go: short ones to the terminal, tracebacks to a file, never to the user's face."""

from __future__ import annotations

import logging
import os
import sys
import tempfile
import traceback
from datetime import datetime
from functools import cache
from pathlib import Path

logger = logging.getLogger("neuralguide")


class _TerminalFormatter(logging.Formatter):
    """Message only: a traceback belongs into the file."""

    def format(self, record: logging.LogRecord) -> str:
        prefix = f"{record.levelname.capitalize()}: " if record.levelno >= logging.WARNING else ""
        return f"NeuralGuide: {prefix}{record.getMessage()}"


class _TerminalHandler(logging.StreamHandler):  # type: ignore[type-arg]
    """Writes to whatever `sys.stderr` is when the message comes; Blender and pytest replace it."""

    @property
    def stream(self):  # type: ignore[no-untyped-def]
        return sys.stderr

    @stream.setter
    def stream(self, value):  # type: ignore[no-untyped-def]
        pass

    def handleError(self, _record: logging.LogRecord) -> None:
        """Nobody reads any more: that must not end a render."""


def log_file() -> Path:
    """The file that tracebacks go to: beside the kernel cache, else one of this process's in the folder for temporary
    files. Where others may write they could have put a link, by which we would write to whatever it leads to.
    """
    from engine.runtime.kernel_cache import cache_root  # imports numba: not while Blender starts
    from engine.runtime.trusted_files import make_folder, weakness

    folder = cache_root().parent
    try:
        make_folder(folder)
        if not weakness(folder) and os.access(folder, os.W_OK):
            return folder / "neuralguide.log"
    except OSError:
        pass
    return _temporary_log()


@cache
def _temporary_log() -> Path:
    descriptor, name = tempfile.mkstemp(prefix="neuralguide-", suffix=".log")
    os.close(descriptor)
    return Path(name)


def register() -> None:
    """Start logging; does nothing the second time."""
    if any(isinstance(handler, _TerminalHandler) for handler in logger.handlers):
        return
    logger.setLevel(logging.INFO)
    logger.propagate = False
    terminal = _TerminalHandler()
    terminal.setFormatter(_TerminalFormatter())
    logger.addHandler(terminal)


def log_failure(message: str) -> Path | None:
    """Append the exception being handled to the log file; returns the file, None where it cannot be written."""
    try:
        path = log_file()
        with path.open("a", encoding="utf-8") as file:
            file.write(f"{datetime.now():%Y-%m-%d %H:%M:%S} {message}\n{traceback.format_exc()}\n")
    except Exception:  # the log must never be what breaks a render
        return None
    return path


def unregister() -> None:
    """Stop logging."""
    for handler in list(logger.handlers):
        if isinstance(handler, _TerminalHandler):
            logger.removeHandler(handler)
