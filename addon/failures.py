# SPDX-License-Identifier: GPL-3.0-or-later
"""What users are told of an exception that ended a render; the traceback goes to a file."""

from __future__ import annotations

from .log import log_failure
from .packages import older_numba


def what_failed(error: Exception, doing: str) -> str:
    """A sentence on an exception that came while something was being done, which is logged."""
    if isinstance(error, ValueError):
        message = str(error)
    elif isinstance(error, MemoryError):
        message = f"out of memory while {doing}: lower the resolution, or simplify meshes and textures"
    elif isinstance(error, ModuleNotFoundError):
        message = older_numba() or f"Python package {error.name} is missing: reinstall NeuralGuide, which brings it"
    else:
        message = older_numba() or f"internal error while {doing}: {type(error).__name__}: {error}"
        path = log_failure(message)
        return message if path is None else f"{message} (details in {path})"
    log_failure(message)
    return message
