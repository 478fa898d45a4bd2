# SPDX-License-Identifier: GPL-3.0-or-later
"""A worker that stands by: started before there is anything to train, it is ready by the time there is.

Importing torch and loading the kernels of training takes seconds. A render that will train a network says so before its
scene is exported (`stand_by`), and whoever starts to train first takes the process (`take`). One at most stands by; it
goes when the renderer goes.
"""

from __future__ import annotations

import contextlib
import os
import sys
import threading
from collections.abc import Collection
from pathlib import Path
from typing import Any

from engine.processes.child import ENTRY, Child
from engine.processes.memory import SharedMemory

#: What workers run.
SERVICE = "guiding.worker.service"
#: Whether a process that runs already can open memory without a name (`SharedMemory.address_for_others`).
CAN_STAND_BY = os.path.isdir("/proc/self/fd")


def launch(
    interpreter: str, config: dict[str, Any], *, thread_count: int = 1, memories: Collection[SharedMemory] = (),
    script: Path = ENTRY,
) -> Child:
    """Start a worker; arguments as for `Child`.

    Raises
    ------
    OSError
        If it cannot be started.
    """
    # Threads that wait for work must not burn the renderer's processors.
    environment = {"OMP_NUM_THREADS": str(thread_count), "OMP_WAIT_POLICY": "PASSIVE", "KMP_BLOCKTIME": "0"}
    return Child(interpreter, SERVICE, config, memories=memories, environment=environment, script=script)


_lock = threading.Lock()
_standing: Child | None = None


def stand_by() -> None:
    """Have a worker stand by, if none does and the system allows it; returns at once and never raises."""
    global _standing
    with _lock:
        if not CAN_STAND_BY or (_standing is not None and _standing.process.poll() is None):
            return
        if _standing is not None:
            _end(_standing)
            _standing = None
        # Without one, training starts its own, and says why where that fails too.
        with contextlib.suppress(OSError):
            _standing = launch(sys.executable, {"stands_by": True})


def take(interpreter: str) -> Child | None:
    """The worker that stands by, if it is alive and runs under this Python; nobody else gets it."""
    global _standing
    with _lock:
        if interpreter != sys.executable:
            return None
        worker, _standing = _standing, None
    if worker is not None and worker.process.poll() is not None:
        _end(worker)
        return None
    return worker


def dismiss() -> None:
    """End the worker that stands by, without waiting for what it is doing: it has nothing to lose."""
    worker = take(sys.executable)
    if worker is not None:
        _end(worker)


def _end(worker: Child) -> None:
    worker.close(is_patient=False)
    worker.release()
