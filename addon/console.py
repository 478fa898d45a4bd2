# SPDX-License-Identifier: GPL-3.0-or-later
"""Writing to terminals, pipes and log files that may be gone by now: what cannot be said must not end a render."""

from __future__ import annotations

import contextlib
import os
import sys
from typing import TextIO


def write(stream: TextIO | None, text: str) -> None:
    """Write and flush. Nothing happens where nobody reads any more, the disk is full, or there is no stream."""
    # ValueError is what a closed stream raises, and what text that its encoding lacks does.
    with contextlib.suppress(OSError, ValueError):
        if stream is not None:
            stream.write(text)
            stream.flush()


def say(text: str) -> None:
    """Write a line to standard output."""
    write(sys.stdout, text + "\n")


def complain(text: str) -> None:
    """Write a line about an error to standard error."""
    write(sys.stderr, f"NeuralGuide: Error: {text}\n")


def is_terminal(stream: TextIO | None) -> bool:
    """Whether somebody sees what is written to `stream` at once."""
    try:
        return stream is not None and stream.isatty()
    except ValueError:  # closed
        return False


def leave() -> None:
    """Let go of what could not be written, before the process ends: Python tries again then, and fails by it."""
    for stream in (sys.stdout, sys.stderr):
        if stream is None:
            continue
        try:
            stream.flush()
        except ValueError:  # closed
            continue
        except OSError:
            with contextlib.suppress(OSError, ValueError):
                nowhere = os.open(os.devnull, os.O_WRONLY)
                os.dup2(nowhere, stream.fileno())
                os.close(nowhere)
