# SPDX-License-Identifier: GPL-3.0-or-later
"""What a started process does about the one that started it."""

from __future__ import annotations

import os
import threading
import time
from typing import Any


def leave_with_parent(config: dict[str, Any]) -> None:
    """End this process when the renderer is gone, even if somebody else holds its end of the pipe (a thread looks)."""
    if os.name == "posix":
        threading.Thread(target=_watch, args=(config["parent"],), name="parent", daemon=True).start()


def leave_with_input() -> None:
    """End this process when its standard input does, a pipe of the renderer's: at once when the renderer is gone.

    For processes that read nothing from it.
    """
    threading.Thread(target=_wait_for_end, name="input", daemon=True).start()


def _wait_for_end() -> None:
    # Past Python's own buffer, which would have to be let go of before the process can end by itself.
    while os.read(0, 1):
        pass
    os._exit(0)


def _watch(parent: int) -> None:
    while os.getppid() == parent:
        time.sleep(1.0)
    os._exit(0)


def step_back(config: dict[str, Any]) -> None:
    """Leave the processors to others that want them, where the renderer asks for it (Windows: it has seen to it)."""
    if config["is_background"] and hasattr(os, "nice"):
        os.nice(5)
